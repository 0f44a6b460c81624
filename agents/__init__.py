"""Agents: those of Mohan (2010), baselines, and the command that serves them."""
