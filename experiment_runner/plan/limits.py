"""The numbers of a plan and their ranges, and other choices that commands show in their help, which is not to
wait for slow imports.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Final

from glue.wire.messages import Role

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
