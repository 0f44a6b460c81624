"""The contents of a recording: runs, episodes and their steps; the letters of their records."""

from __future__ import annotations

import json
import math
import struct
from abc import abstractmethod
from array import array
from bisect import bisect_left, bisect_right
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, ClassVar, Final, NamedTuple, overload

import numpy as np
import numpy.typing as npt

from glue.errors import LocalProtocolError
from glue.options import Value
from glue.trajectory import limits
from glue.types import Action, Observation, body_size


class Transition(NamedTuple):
    """An action and its outcome; the observation is None in an actions-only recording."""

    action: Action
    reward: float
    observation: Observation | None
    terminal: bool


class StepSequence(Sequence[Transition]):
    """The steps of an episode, decoded one at a time when they are accessed; equal to any sequence of equal
    steps."""

    @abstractmethod
    def _step(self, index: int) -> Transition:
        """Return the step at an index from 0 to the length less 1."""

    @overload
    def __getitem__(self, index: int) -> Transition: ...
    @overload
    def __getitem__(self, index: slice) -> tuple[Transition, ...]: ...
    def __getitem__(self, index: int | slice) -> Transition | tuple[Transition, ...]:
        which = range(len(self))[index]
        if isinstance(which, range):
            return tuple(map(self._step, which))
        return self._step(which)

    def __iter__(self) -> Iterator[Transition]:
        return map(self._step, range(len(self)))

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Sequence):
            return NotImplemented
        return len(self) == len(other) and all(map(tuple.__eq__, self, other))

    __hash__: ClassVar[None] = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        return f"<{len(self)} steps>"


class Steps(StepSequence):
    """The steps of an episode that was recorded with its observations.

    They are kept as bytes: a million small steps take 60 MB; as objects they would take ten times as much.
    """

    def __init__(self) -> None:
        self._data = bytearray()
        self._starts = array("Q")
        self._terminal = False

    def append(self, reward: bytes, action: bytes, observation: bytes, terminal: bool) -> None:
        """Add a step, given as the fields of its record; only the last step may be terminal."""
        self._starts.append(len(self._data))
        self._data += reward + action + observation
        self._terminal = terminal

    def __len__(self) -> int:
        return len(self._starts)

    def _step(self, index: int) -> Transition:
        start = self._starts[index]
        end = self._starts[index + 1] if index + 1 < len(self) else len(self._data)
        record = bytes(memoryview(self._data)[start:end])
        (reward,) = REWARD.unpack_from(record)
        middle = REWARD.size + body_size(record, REWARD.size)
        return Transition(
            Action._wrap(record[REWARD.size : middle]),
            reward,
            Observation._wrap(record[middle:]),
            self._terminal and index == len(self) - 1,
        )


class Block(NamedTuple):
    """Consecutive steps of an episode.

    Attributes:
        actions: bodies of the distinct actions, k of them.
        choices: index of each step's action, shape (n,), each below k.
        rewards: reward of each step, shape (n,).
    """

    actions: tuple[bytes, ...]
    choices: npt.NDArray[np.unsignedinteger[Any]]
    rewards: npt.NDArray[np.float64]


class ActionSteps(StepSequence):
    """The steps of an episode of an actions-only recording; their observations are None.

    Attributes:
        blocks: the steps in order, in blocks.
    """

    def __init__(self) -> None:
        self.blocks: list[Block] = []
        self._ends: list[int] = []
        self._terminal = False

    def append(self, block: Block) -> None:
        """Add further steps."""
        self.blocks.append(block)
        self._ends.append(len(self) + len(block.choices))

    def end(self, terminal: bool) -> None:
        """Set whether the last step was terminal."""
        self._terminal = terminal

    def __len__(self) -> int:
        return self._ends[-1] if self._ends else 0

    def _step(self, index: int) -> Transition:
        number = bisect_right(self._ends, index)
        actions, choices, rewards = self.blocks[number]
        at = index - self._ends[number]  # from the block's end
        terminal = self._terminal and index == len(self) - 1
        return Transition(Action.from_body(actions[choices[at]]), rewards[at].item(), None, terminal)


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
