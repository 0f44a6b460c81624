"""Agents of Infinite Mario, and what all of them see of it."""
