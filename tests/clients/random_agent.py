"""The random agent, an example of every client library, in Python: the same seed gives the same actions."""

from __future__ import annotations

import re

from glue.roles import Agent
from glue.taskspec import legal_values
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


def bounds_of(task_spec: str) -> list[tuple[int, int]]:
    """Return the bounds of each int of an action: `ACTIONS INTS (-1 1) (2 0 1)` are three."""
    actions = re.search(r"\bACTIONS\s+INTS((?:\s*\([^)]*\))*)", task_spec)
    assert actions is not None
    return [
        (int(low), int(high))
        for count, low, high in re.findall(r"\(\s*(?:(\d+)\s+)?(-?\d+)\s+(-?\d+)\s*\)", actions[1])
        for _ in range(int(count or 1))
    ]


class RandomAgent(Agent):
    """Acts at random within the bounds of the task spec, with a generator available to any language."""

    name = "random"
    agent_masks = True

    def __init__(self) -> None:
        self._generator = Generator(0)
        self._bounds: list[tuple[int, int]] = []

    def agent_seed(self, seed: int) -> None:
        self._generator = Generator(seed)

    def agent_init(self, task_spec: str) -> None:
        self._bounds = bounds_of(task_spec)

    def agent_start(self, observation: Observation) -> Action:
        return self._act(observation)

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return self._act(observation)

    def _act(self, observation: Observation) -> Action:
        legal = legal_values(observation, tuple(high - low + 1 for low, high in self._bounds))
        values = [flags.nonzero()[0] for flags in legal]
        bounds = zip(self._bounds, values, strict=True)
        return Action([low + int(each[self._generator.draw(len(each))]) for (low, _), each in bounds])
