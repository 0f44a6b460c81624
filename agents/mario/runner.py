"""The simplest agent that gets anywhere in Infinite Mario: it runs to the right and jumps whenever it can."""

from __future__ import annotations

from typing import Final

from glue.roles import Agent
from glue.types import Action, Observation

_RUN_AND_JUMP: Final = Action(ints=[1, 1, 1])


class RunRightAgent(Agent):
    """Always runs to the right and jumps; it learns nothing."""

    def agent_start(self, observation: Observation) -> Action:
        return _RUN_AND_JUMP

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return _RUN_AND_JUMP

    def agent_message(self, message: str) -> str:
        return "I run to the right and jump"
