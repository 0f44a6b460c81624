"""Settings of a run that the command line shows in its help, in a module that imports nothing slow."""

from __future__ import annotations

from enum import StrEnum
from typing import Final

CHECKPOINT_EVERY: Final = 100
"""Default number of episodes between checkpoints."""


class Backend(StrEnum):
    """Where trials run: on this machine, on a Ray cluster, or as tasks of a SLURM job array."""

    LOCAL = "local"
    RAY = "ray"
    SLURM = "slurm"
