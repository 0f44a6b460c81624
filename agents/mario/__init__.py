"""Agents for Infinite Mario, and their common perception of it."""
