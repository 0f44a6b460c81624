"""Recorded episodes: replayed, compared, drawn."""
