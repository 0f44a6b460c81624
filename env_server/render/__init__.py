"""Observations as text and as pictures."""
