"""The run directory: what an experiment leaves on disk."""
