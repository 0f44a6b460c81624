"""Experiments: plans, trials, results, and the commands around them."""
