"""An example agent to copy and change."""

from __future__ import annotations

from glue.roles import Agent
from glue.types import Action, Observation

__all__ = ["Runner"]

# Direction, jump, run.
_RIGHT, _JUMP = Action(ints=[1, 0, 1]), Action(ints=[1, 1, 1])


class Runner(Agent):
    """Plays Mario: runs to the right, and releases jump every tenth step."""

    def __init__(self) -> None:
        self._steps = 0

    def agent_start(self, observation: Observation) -> Action:
        self._steps = 0
        return _RIGHT

    def agent_step(self, reward: float, observation: Observation) -> Action:
        self._steps += 1
        return _JUMP if self._steps % 10 else _RIGHT
