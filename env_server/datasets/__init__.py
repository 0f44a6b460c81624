"""Recordings as datasets for offline learning."""
