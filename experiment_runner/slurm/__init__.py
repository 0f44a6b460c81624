"""Trials as tasks of a SLURM job array."""
