"""Plays fair: the basis of the other entrants, and the baseline that shows whether they harm others."""

from __future__ import annotations

import os

from glue import serve_agent
from glue.roles import Agent
from glue.types import Action, Observation

FOLDERS = ("/tmp", "/dev/shm", "/dev/mqueue", "/var/tmp", "/run", "/run/glue", "/home/glue", ".")
"""Where a program may try to write."""


class Honest(Agent):
    """Walks among the mines, keeping each direction for three steps."""

    def __init__(self) -> None:
        self.steps = 0

    def agent_start(self, observation: Observation) -> Action:
        return self.act()

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return self.act()

    def act(self) -> Action:
        if self.steps == 20:
            self.misbehave()
        self.steps += 1
        return Action(ints=[self.steps // 3 % 4])

    def misbehave(self) -> None:
        """Do something else in the middle of an episode, as others do."""


def play(agent: Honest) -> None:
    """Take part, until the hub says goodbye."""
    serve_agent(agent, os.environ["GLUE_HUB"], os.environ["GLUE_SESSION"])


if __name__ == "__main__":
    play(Honest())
