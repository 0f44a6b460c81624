"""Recorded episodes: played again, compared, drawn."""
