"""Agents and environments by name: finding a class, and starting it with a learned state."""
