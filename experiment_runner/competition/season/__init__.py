"""A competition that stays open: its rules, its server, and its entrants' side."""
