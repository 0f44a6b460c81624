"""Plays fair: what the others begin with, and the measure of what their company costs."""

from __future__ import annotations

import os

from glue import serve_agent
from glue.types import Action, Observation

_RIGHT, _JUMP = Action(ints=[1, 0, 1]), Action(ints=[1, 1, 1])


class Honest:
    """Runs to the right in Infinite Mario, and lets go of jump every tenth step."""

    def __init__(self) -> None:
        self.steps = 0

    def agent_init(self, task_spec: str) -> None:
        pass

    def agent_start(self, observation: Observation) -> Action:
        return self.act()

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return self.act()

    def agent_end(self, reward: float) -> None:
        pass

    def agent_cleanup(self) -> None:
        pass

    def agent_message(self, message: str) -> str:
        return ""

    def act(self) -> Action:
        self.steps += 1
        return _JUMP if self.steps % 10 else _RIGHT


def play(agent: Honest) -> None:
    """Take part, until the hub says goodbye."""
    serve_agent(agent, os.environ["GLUE_HUB"], os.environ["GLUE_SESSION"])


if __name__ == "__main__":
    play(Honest())
