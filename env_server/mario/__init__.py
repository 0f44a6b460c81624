"""Infinite Mario of the RL-Competition 2009."""
