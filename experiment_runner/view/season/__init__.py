"""The page of a season: open to all, with more for those who have a token."""
