"""Runs and their episodes, and the letters of their records."""

from __future__ import annotations

import json
import math
import struct
from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Final, NamedTuple

from glue.errors import LocalProtocolError
from glue.options import Value
from glue.trajectory import limits
from glue.trajectory.steps import Transition
from glue.types import Observation

MAGIC: Final = b"GLUETRJ1"
RUN, MESSAGE, START, STEP, TERMINAL_STEP, CUTOFF, VOID = b"R", b"M", b"O", b"S", b"T", b"C", b"V"
ANSWER: Final = b"A"
BEGIN, BLOCK, LATE_BLOCK, TERMINAL_END = b"B", b"P", b"Q", b"E"  # of an actions-only episode
LATE: Final = b"L"
LENGTH: Final = struct.Struct("<I")
COUNTS: Final = struct.Struct("<III")  # of a block: its steps, distinct actions and distinct rewards
REWARD: Final = struct.Struct("<d")


class Ending(Enum):
    """The end of an episode."""

    TERMINAL = "terminal"  # its last step was terminal
    CUTOFF = "cutoff"  # truncated, by a step limit or the experiment
    VOID = "void"  # a player was lost, or the recording stopped: it does not count


END_OF: Final = {Ending.TERMINAL: TERMINAL_END, Ending.CUTOFF: CUTOFF, Ending.VOID: VOID}
"""Letter of the record with which an actions-only episode ends."""

ENDINGS: Final = {letter: ending for ending, letter in END_OF.items()}
"""Ending of an episode by the letter of its last record, unless that is a terminal step."""


@dataclass(frozen=True, slots=True)
class Run:
    """The source of episodes: an environment between its env_init and its env_cleanup.

    Attributes:
        environment: the environment's name for `glue-env`; "" if unknown.
        options: its options, without those at their defaults.
        task_spec: result of env_init.
        seed: argument of env_seed before env_init; None if it was not called.
        state: argument of env_load after env_init; b"" if it was not called.
    """

    environment: str
    options: Mapping[str, Value]
    task_spec: str
    seed: int | None = None
    state: bytes = b""


class Answer(NamedTuple):
    """The agent's answer to a message at a step: 0 is the start, n the time after step n."""

    step: int
    message: str
    answer: str


@dataclass(frozen=True, slots=True)
class Episode:
    """One episode: the first observation, then its steps.

    Attributes:
        run: the run that it belongs to.
        messages: texts sent to the environment since the previous episode began.
        start: the first observation; None in an actions-only recording.
        steps: the steps in order.
        ending: its end.
        answers: the agent's answers to messages during the episode.
        late: the numbers, from 1, of the steps whose action was late (see `glue.pace`).
    """

    run: Run
    messages: tuple[str, ...]
    start: Observation | None
    steps: Sequence[Transition]
    ending: Ending
    answers: tuple[Answer, ...] = ()
    late: Sequence[int] = ()

    def is_late(self, step: int) -> bool:
        """Return whether the action of a step, counted from 1, was late."""
        place = bisect_left(self.late, step)
        return place < len(self.late) and self.late[place] == step

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


def text_record(kind: bytes, text: str) -> bytes:
    """Return the record of a text.

    Raises:
        LocalProtocolError: the text is not Unicode, or takes more than `MAX_TEXT`.
    """
    try:
        encoded = text.encode()
    except UnicodeEncodeError as error:
        raise LocalProtocolError(f"a text that is not Unicode cannot be recorded: {error}") from None
    if len(encoded) > limits.MAX_TEXT:
        raise LocalProtocolError(
            f"a text of {len(encoded)} bytes cannot be recorded; {limits.MAX_TEXT} are allowed"
        )
    return kind + LENGTH.pack(len(encoded)) + encoded


def run_record(run: Run) -> bytes:
    """Return the record with which a run begins.

    Raises:
        LocalProtocolError: the options are not plain values, or the run takes more than `MAX_TEXT`.
    """
    for name, value in run.options.items():
        if not is_plain(value):
            raise LocalProtocolError(f"option {name} cannot be recorded: {value!r} is not a plain value")
    fields = {
        "environment": run.environment,
        "options": dict(run.options),
        "task_spec": run.task_spec,
        "seed": run.seed,
        "state": run.state.hex(),
    }
    return text_record(RUN, json.dumps(fields))


def width(count: int) -> str:
    """Return the smallest dtype that holds the integers below `count`."""
    return "<u1" if count <= 2**8 else "<u2" if count <= 2**16 else "<u4"
