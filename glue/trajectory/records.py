"""What a recording consists of: runs and their episodes, and the letters of their records."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Final, NamedTuple

from glue.options import Value
from glue.trajectory.steps import Step
from glue.types import Observation

__all__ = [
    "ANSWER",
    "CUTOFF",
    "ENDINGS",
    "LENGTH",
    "MAGIC",
    "MESSAGE",
    "REWARD",
    "RUN",
    "START",
    "STEP",
    "TERMINAL_STEP",
    "VOID",
    "Answer",
    "Ending",
    "Episode",
    "Run",
    "is_plain",
]

MAGIC: Final = b"GLUETRJ1"
RUN, MESSAGE, START, STEP, TERMINAL_STEP, CUTOFF, VOID = b"R", b"M", b"O", b"S", b"T", b"C", b"V"
ANSWER: Final = b"A"
LENGTH: Final = struct.Struct("<I")
REWARD: Final = struct.Struct("<d")


class Ending(Enum):
    """How an episode ended."""

    TERMINAL = "terminal"  # its last step was terminal
    CUTOFF = "cutoff"  # truncated, by a step limit or the experiment
    VOID = "void"  # a player was lost, or the recording stopped: it does not count


ENDINGS: Final = {TERMINAL_STEP: Ending.TERMINAL, CUTOFF: Ending.CUTOFF, VOID: Ending.VOID}


@dataclass(frozen=True, slots=True)
class Run:
    """Where episodes come from: an environment between its env_init and its env_cleanup.

    Attributes:
        environment: its name for `glue-env`, or "" if that is not known.
        options: its options; what is left out has its default.
        task_spec: what env_init returned.
        seed: what env_seed was given before env_init, if anything.
        state: what env_load was given after env_init; b"" if nothing.
    """

    environment: str
    options: Mapping[str, Value]
    task_spec: str
    seed: int | None = None
    state: bytes = b""


class Answer(NamedTuple):
    """What the agent answered to a message at a step: 0 is the start, n the moment after step n."""

    step: int
    message: str
    answer: str


@dataclass(frozen=True, slots=True)
class Episode:
    """One episode: the first observation, then its steps.

    `messages` are the texts that the environment was sent since the start of the episode before, `answers`
    what the agent answered to those that it was sent during this one.
    """

    run: Run
    messages: tuple[str, ...]
    start: Observation
    steps: Sequence[Step]
    ending: Ending
    answers: tuple[Answer, ...] = ()

    @property
    def episode_return(self) -> float:
        """The sum of the rewards, added in their order."""
        total = 0.0
        for step in self.steps:
            total += step.reward
        return total


def is_plain(value: object) -> bool:
    """Return whether an option of this value can be recorded."""
    return type(value) in (int, str, bool) or (type(value) is float and math.isfinite(value))
