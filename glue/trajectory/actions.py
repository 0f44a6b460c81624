"""Actions-only recordings: the actions and rewards of episodes, without their observations.

A deterministic environment reproduces the observations by executing the actions. A step takes about one
byte, and blocks of steps are read as arrays, so that a competition's scores are quickly verified.
"""

from __future__ import annotations

import struct
import zlib
from array import array
from bisect import bisect_right
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from glue.errors import LocalProtocolError
from glue.trajectory import limits
from glue.trajectory.records import BEGIN, BLOCK, END_OF, MAGIC, Ending, Run, run_record
from glue.trajectory.steps import StepSequence, Transition
from glue.trajectory.unpacked import GZIP, Unpacked
from glue.types import Action

_COUNTS: Final = struct.Struct("<III")

_MAX_ACTIONS_SIZE: Final = 2**23
_STEP_SIZE: Final = 32
"""Maximum bytes of a step besides its action: two indices, a reward, and the counts of its block."""
"""Bytes of distinct actions after which the writer ends a block."""


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


class ActionWriter:
    """Write an actions-only recording in pieces of bytes, complete once `close` has been called.

    Args:
        send: receives each piece.
    """

    def __init__(self, send: Callable[[bytes], object]) -> None:
        self._send = send
        self._pack = zlib.compressobj(wbits=GZIP)
        self._has_run = False
        self._in_episode = False
        self._size = 0  # bytes of the episode's blocks
        self._open = 0  # bytes of the open block, at most
        self._actions: dict[bytes, int] = {}
        self._actions_size = 0
        self._choices = array("I")
        self._rewards = array("d")
        self._write(MAGIC)

    def run(self, run: Run) -> None:
        """Begin the episodes of an environment. Cuts off an open episode.

        Raises:
            LocalProtocolError: the options are not plain values, or the run takes more than `MAX_TEXT`.
        """
        record = run_record(run)
        self.end(Ending.CUTOFF)
        self._write(record)
        self._has_run = True

    def start(self) -> None:
        """Begin an episode. Cuts off an open one.

        Raises:
            LocalProtocolError: there is no run yet.
        """
        if not self._has_run:
            raise LocalProtocolError("no run is open: a recording begins with run()")
        self.end(Ending.CUTOFF)
        self._in_episode = True
        self._size = 0
        self._write(BEGIN)

    def step(self, action: bytes, reward: float) -> None:
        """Add a step of the open episode: the body of its action, and its reward.

        Raises:
            LocalProtocolError: no episode is open, or the episode exceeds a limit of a recording.
        """
        if not self._in_episode:
            raise LocalProtocolError("no episode is open: a recording needs start() before its steps")
        if len(self._choices) == limits.MAX_BLOCK or self._actions_size >= _MAX_ACTIONS_SIZE:
            self._end_block()
        choice = self._actions.get(action)
        size = self._open + _STEP_SIZE + (len(action) if choice is None else 0)
        if len(action) > limits.MAX_BODY or self._size + size > limits.MAX_EPISODE:
            raise LocalProtocolError(
                f"an action of more than {limits.MAX_BODY} bytes or an episode of more than "
                f"{limits.MAX_EPISODE} bytes cannot be recorded"
            )
        self._open = size
        if choice is None:
            choice = self._actions[action] = len(self._actions)
            self._actions_size += len(action)
        self._choices.append(choice)
        self._rewards.append(reward)

    def end(self, ending: Ending) -> None:
        """End the open episode. Nothing happens if none is open."""
        if self._in_episode:
            self._in_episode = False
            self._end_block()
            self._write(END_OF[ending])

    def close(self) -> None:
        """Void the open episode, and send the last piece."""
        self.end(Ending.VOID)
        self._send(self._pack.flush())

    def _end_block(self) -> None:
        if self._choices:
            record = _block_record(tuple(self._actions), self._choices, self._rewards)
            self._size += len(record)
            self._open = 0
            self._write(record)
            self._actions.clear()
            self._actions_size = 0
            del self._choices[:], self._rewards[:]

    def _write(self, record: bytes) -> None:
        if packed := self._pack.compress(record):
            self._send(packed)


def _block_record(actions: tuple[bytes, ...], choices: array[int], rewards: array[float]) -> bytes:
    # Compared by their bits: 0.0 and -0.0 are two rewards.
    bits, paid = np.unique(np.array(rewards, np.float64).view(np.uint64), return_inverse=True)
    return b"".join(
        (
            BLOCK,
            _COUNTS.pack(len(choices), len(actions), len(bits)),
            *actions,
            bits.astype("<u8").tobytes(),
            np.array(choices, _width(len(actions))).tobytes(),
            paid.astype(_width(len(bits))).tobytes(),
        )
    )


def read_block(unpacked: Unpacked, end: int) -> Block:
    """Read the fields of a block of steps.

    Args:
        unpacked: the contents of a recording, after the block's letter.
        end: offset that the block's actions may not pass.

    Raises:
        TrajectoryError: the fields are malformed.
    """
    steps, k, m = _COUNTS.unpack(unpacked.take(_COUNTS.size))
    if not (1 <= steps <= limits.MAX_BLOCK and 1 <= k <= steps and 1 <= m <= steps):
        raise unpacked.malformed(f"a block of {steps} steps with {k} actions and {m} rewards")
    actions = []
    for _ in range(k):
        actions.append(unpacked.body(limits.MAX_BODY))
        if unpacked.offset > end:
            raise unpacked.malformed(f"an episode of more than {limits.MAX_EPISODE} bytes")

    def column(dtype: str, count: int) -> npt.NDArray[Any]:
        return np.frombuffer(unpacked.take(count * np.dtype(dtype).itemsize), dtype)

    rewards = column("<f8", m)
    choices, paid = column(_width(k), steps), column(_width(m), steps)
    if choices.max() >= k or paid.max() >= m:
        raise unpacked.malformed("a step with an action or reward that its block does not have")
    return Block(tuple(actions), choices, rewards[paid])


def _width(count: int) -> str:
    """Return the smallest dtype that holds the integers below `count`."""
    return "<u1" if count <= 2**8 else "<u2" if count <= 2**16 else "<u4"
