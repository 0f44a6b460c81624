"""A network that imitates a search."""

from agents.imitation.agent import ImitationAgent as ImitationAgent
