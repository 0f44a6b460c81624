"""Statistics of a run's trials."""
