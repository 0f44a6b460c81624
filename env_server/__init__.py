"""Environments of the glue: Infinite Mario and small tasks, and the command that serves them."""
