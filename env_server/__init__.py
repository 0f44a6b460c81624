"""Environments: Infinite Mario and small tasks, and the command that serves them."""
