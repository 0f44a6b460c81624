"""A small network that has learned to play: the agent `network`, and the file of its weights."""

from agents.network.agent import NetworkAgent as NetworkAgent
