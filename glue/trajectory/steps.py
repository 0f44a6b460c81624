"""The steps of an episode, read from a recording."""

from __future__ import annotations

import struct
from abc import abstractmethod
from array import array
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from typing import Any, ClassVar, Final, NamedTuple, overload

import numpy as np
import numpy.typing as npt

from glue.types import Action, Observation, body_size

_REWARD: Final = struct.Struct("<d")


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
        (reward,) = _REWARD.unpack_from(record)
        middle = _REWARD.size + body_size(record, _REWARD.size)
        return Transition(
            Action._wrap(record[_REWARD.size : middle]),
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
