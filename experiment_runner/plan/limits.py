"""The numbers of a plan and their ranges, and other choices that commands show in their help, which is not to
wait for slow imports.

Trial ids, as in `hierarchical/step_size=0.1/mario/level_difficulty=0/3`, and the labels they are made of.

Only this module writes and reads the text of an id.
"""

from __future__ import annotations

import re
from enum import StrEnum
from typing import Final, Self

from glue.errors import ExperimentError
from glue.wire.messages import Role

REMOTE: Final = "remote"
"""Part of a trial's id in place of a player that joins from outside."""


class TrialId(str):
    """The id of a trial: agent, environment and number, each with the swept options that distinguish it."""

    __slots__ = ()

    @classmethod
    def of(cls, agent: str, environment: str, number: int) -> Self:
        """Return the id of trial `number` of an agent in an environment."""
        return cls(f"{agent}/{environment}/{number}")

    @property
    def parts(self) -> tuple[str, str, int]:
        """Agent, environment and number of a trial without swept options, as in a competition.

        Raises:
            ExperimentError: the id has other parts.
        """
        agent, _, rest = self.partition("/")
        environment = rest.rpartition("/")[0]
        if not agent or not environment or "/" in environment:
            raise ExperimentError(f"{self!s} is not the id of an agent, an environment and a number")
        return agent, environment, self.number

    @property
    def number(self) -> int:
        """The trial's number among those of its agent and environment, from 0.

        Raises:
            ExperimentError: the id does not end with a number.
        """
        last = self.rpartition("/")[2]
        if not re.fullmatch(r"[0-9]{1,9}", last):
            raise ExperimentError(f"the id of trial {self!s} does not end with its number")
        return int(last)

    def naming(self, agent: str | None, environment: str | None) -> str:
        """Return the id with the names of players from outside in place of `REMOTE`.

        Args:
            agent: name of the agent that joined; None if no agent has, or the agent is part of the plan.
            environment: the same for the environment.
        """
        parts = self.split("/")
        if agent is not None and parts[0] == REMOTE:
            parts[0] = agent
        if environment is not None and parts[-2:-1] == [REMOTE]:
            parts[-2] = environment
        return "/".join(parts)


def label_of(name: str) -> str:
    """Return the label for a name: its letters, digits and _ . + -, with a hyphen for other characters."""
    return re.sub(r"[^\w.+-]+", "-", name).strip("-") or "-"


COUNTS: Final = {
    "episodes": range(2**63),
    "steps": range(2**63),
    "max_steps": range(2**32),
    "trials": range(1, 1_000_001),
    "seed": range(2**63),
}
PACE: Final = ("rate", "late", "delay")
"""The settings of a plan that make up its pace."""
BUDGETS: Final = ("episodes", "steps")
"""The lengths of a trial, of which a plan has one; the other is 0."""
PLAYERS: Final = {"agent": Role.AGENT, "env": Role.ENVIRONMENT}
"""The players, by their names in options and plans."""

CHECKPOINT_EVERY: Final = 100
"""Default number of episodes between checkpoints."""


class Backend(StrEnum):
    """The place where trials run: this machine, a Ray cluster, or a SLURM job array."""

    LOCAL = "local"
    RAY = "ray"
    SLURM = "slurm"
