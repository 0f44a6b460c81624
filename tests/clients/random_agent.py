"""The random agent, an example of every client library, in Python: the same seed gives the same actions."""

from __future__ import annotations

from glue.roles import Agent
from glue.taskspec import legal_values, mask_sizes, parse_task_spec
from glue.types import Action, Observation


class Generator:
    """Numerical Recipes' linear congruential generator: 32 bits of state, of which the upper 16 are drawn.

    Args:
        seed: only its lower 32 bits count.
    """

    def __init__(self, seed: int) -> None:
        self._state = seed & 0xFFFFFFFF

    def draw(self, n: int) -> int:
        """Return a number from 0 to n - 1."""
        self._state = (self._state * 1664525 + 1013904223) & 0xFFFFFFFF
        return (self._state >> 16) % n


class RandomAgent(Agent):
    """Acts at random within the bounds of the task spec, with a generator available to any language."""

    name = "random"
    agent_masks = True

    def __init__(self) -> None:
        self._generator = Generator(0)

    def agent_seed(self, seed: int) -> None:
        self._generator = Generator(seed)

    def agent_init(self, task_spec: str) -> None:
        self._actions = parse_task_spec(task_spec).actions

    def agent_start(self, observation: Observation) -> Action:
        return self._act(observation)

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return self._act(observation)

    def _act(self, observation: Observation) -> Action:
        values = [legal.nonzero()[0] for legal in legal_values(observation, mask_sizes(self._actions))]
        lows = [int(bounds.ends[0]) for bounds in self._actions.ints]
        drawn = (each[self._generator.draw(len(each))] for each in values)
        return Action([low + int(value) for low, value in zip(lows, drawn, strict=True)])
