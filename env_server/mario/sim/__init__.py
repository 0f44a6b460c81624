"""The game of the RL-Competition 2009 Infinite Mario domain: its state and its rules, nothing else."""
