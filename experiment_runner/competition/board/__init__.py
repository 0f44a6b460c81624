"""The standings of a competition: computed, and shown in the terminal, as CSV, as JSON and as a page."""
