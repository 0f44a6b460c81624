"""Infinite Mario of the RL-Competition 2009."""

from env_server.mario.environment import InfiniteMario

__all__ = ["InfiniteMario"]
