"""Output for people: progress, tables and figures."""
