"""Settings of a run that the command line shows in its help, in a module that imports nothing slow."""

from __future__ import annotations

from enum import StrEnum
from typing import Final

CHECKPOINT_EVERY: Final = 100
"""Default number of episodes between checkpoints."""


class Backend(StrEnum):
    """The place where trials run: this machine, a Ray cluster, or a SLURM job array."""

    LOCAL = "local"
    RAY = "ray"
    SLURM = "slurm"
