"""Parts of socket code that a hub and its peers share."""
