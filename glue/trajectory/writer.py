"""Write recordings, record by record."""

from __future__ import annotations

import os
import zlib
from array import array
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Final

import numpy as np

from glue.closing import Closing
from glue.errors import LocalProtocolError
from glue.trajectory import limits, records
from glue.trajectory.reader import GZIP, TrajectoryError
from glue.types import AbstractType, Action, Observation

_NO_EPISODE: Final = "no episode is open: a recording needs start() before its steps"

_MAX_ACTIONS_SIZE: Final = 2**23
"""Bytes of distinct actions after which a block of steps ends."""

_STEP_SIZE: Final = 32
"""Maximum bytes of a step besides its action: two indices, a reward, and the counts of its block."""


class _Writer:
    """Runs and episodes, packed.

    Args:
        send: receives each piece of the packed recording.
    """

    def __init__(self, send: Callable[[bytes], object]) -> None:
        self._send = send
        self._pack = zlib.compressobj(wbits=GZIP)
        self._has_run = False
        self._in_episode = False
        self._size = 0  # bytes of the episode's records
        self._write(records.MAGIC)

    def run(self, run: records.Run) -> None:
        """Record the environment that the following episodes come from. Cuts off an open episode.

        Raises:
            LocalProtocolError: the options are not plain values, the run takes more than `MAX_TEXT`, or
                the recording is closed.
        """
        record = records.run_record(run)
        self._end(records.Ending.CUTOFF)
        self._write(record)
        self._has_run = True

    def close(self) -> None:
        """Void the open episode and complete the recording."""
        self._end(records.Ending.VOID)
        self._send(self._pack.flush())

    def _begin(self, record: bytes) -> None:
        self._size = 0
        self._grow(record)
        self._in_episode = True

    def _end(self, ending: records.Ending) -> None:
        if self._in_episode:
            self._in_episode = False
            self._write(records.END_OF[ending])

    def _needs_run(self) -> None:
        if not self._has_run:
            raise LocalProtocolError("no run is open: a recording starts with run() and ends with close()")

    def _grow(self, record: bytes) -> None:
        self._size += len(record)
        if self._size > limits.MAX_EPISODE:
            raise LocalProtocolError(f"an episode of more than {limits.MAX_EPISODE} bytes cannot be recorded")
        self._write(record)

    def _write(self, record: bytes) -> None:
        if packed := self._pack.compress(record):
            self._send(packed)


class TrajectoryWriter(_Writer, Closing):
    """Write a new file, record by record; every episode that ended is on disk.

    Use it as a context manager, or call `close`.

    Raises:
        TrajectoryError: the file exists already, or cannot be written.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self._path = Path(path)
        try:
            self._file = open(self._path, "xb")  # noqa: SIM115 - closed by close()
        except FileExistsError:
            raise TrajectoryError(f"{path} exists already: remove it, or record to another file") from None
        except OSError as error:
            raise self._unwritable(error) from None
        self._steps = 0
        self._messages: list[bytes] = []
        self._answers: list[bytes] = []
        self._answered = 0  # in the open episode
        super().__init__(self._store)
        self._flush()

    def run(self, run: records.Run) -> None:
        if self._file.closed:
            raise LocalProtocolError("the recording is closed")
        super().run(run)
        self._messages.clear()
        self._answers.clear()

    def message(self, text: str) -> None:
        """Record a text that was sent to the environment, with the next episode to start.

        Raises:
            LocalProtocolError: there is no run yet, the text takes more than `MAX_TEXT`, or there are more
                than `MAX_STEPS` of them before an episode.
        """
        self._needs_run()
        if len(self._messages) == limits.MAX_STEPS:
            raise LocalProtocolError(f"more than {limits.MAX_STEPS} messages in a row cannot be recorded")
        self._messages.append(records.text_record(records.MESSAGE, text))

    def answer(self, message: str, answer: str) -> None:
        """Record the agent's answer to a message at the start or step that is recorded next.

        Raises:
            LocalProtocolError: there is no run yet, a text takes more than `MAX_TEXT`, or there are more
                than `MAX_STEPS` answers in an episode.
        """
        self._needs_run()
        if self._answered + len(self._answers) == limits.MAX_STEPS:
            raise LocalProtocolError(f"more than {limits.MAX_STEPS} answers in an episode cannot be recorded")
        self._answers.append(records.text_record(records.ANSWER, message) + records.text_record(b"", answer))

    def start(self, observation: Observation) -> None:
        """Begin an episode. Cuts off an open one.

        Raises:
            LocalProtocolError: there is no run yet, or the observation takes more than `MAX_BODY`.
        """
        self._needs_run()
        self.cutoff()
        record = b"".join((*self._messages, *self._answers, records.START, _body_of(observation)))
        self._messages.clear()
        self._steps = 0
        self._answered = len(self._answers)
        self._answers.clear()
        self._begin(record)

    def step(
        self, action: Action, reward: float, observation: Observation, terminal: bool, *, late: bool = False
    ) -> None:
        """Record a step of the open episode; a terminal step ends it.

        `late` says that the action was late (see `glue.pace`).

        Raises:
            LocalProtocolError: no episode is open, or a limit of `glue.trajectory.limits` is exceeded.
        """
        if not self._in_episode:
            raise LocalProtocolError(_NO_EPISODE)
        if self._steps == limits.MAX_STEPS:
            raise LocalProtocolError(f"an episode of more than {limits.MAX_STEPS} steps cannot be recorded")
        self._steps += 1
        kind = (records.LATE if late else b"") + (records.TERMINAL_STEP if terminal else records.STEP)
        fields = (records.REWARD.pack(reward), _body_of(action), _body_of(observation))
        self._grow(b"".join((*self._answers, kind, *fields)))
        self._answered += len(self._answers)
        self._answers.clear()
        if terminal:
            self._in_episode = False
            self._flush()

    def cutoff(self) -> None:
        """End the open episode without a terminal step. Nothing happens if none is open."""
        self._end(records.Ending.CUTOFF)

    def void(self) -> None:
        """End the open episode as one that does not count. Nothing happens if none is open."""
        self._end(records.Ending.VOID)

    def close(self) -> None:
        """Void the open episode and close the file. May be called twice."""
        if not self._file.closed:
            super().close()
            self._shut()

    def _end(self, ending: records.Ending) -> None:
        if self._in_episode:
            super()._end(ending)
            self._flush()

    def _flush(self) -> None:
        self._store(self._pack.flush(zlib.Z_SYNC_FLUSH), now=True)

    def _store(self, packed: bytes, now: bool = False) -> None:
        try:
            self._file.write(packed)
            if now:
                self._file.flush()
        except OSError as error:
            with suppress(OSError):
                self._shut()
            raise self._unwritable(error) from None

    def _shut(self) -> None:
        self._has_run = self._in_episode = False
        self._file.close()

    def _unwritable(self, error: OSError) -> TrajectoryError:
        return TrajectoryError(f"cannot write {self._path}: {error.strerror}")


class ActionWriter(_Writer):
    """Write an actions-only recording in pieces of bytes, complete once `close` has been called.

    A deterministic environment reproduces the observations by executing the actions. A step takes about one
    byte, and blocks of steps are read as arrays, so that a competition's scores are quickly verified.

    Args:
        send: receives each piece.
    """

    def __init__(self, send: Callable[[bytes], object]) -> None:
        super().__init__(send)
        self._open = 0  # bytes of the open block, at most
        self._actions: dict[bytes, int] = {}
        self._actions_size = 0
        self._choices = array("I")
        self._late = bytearray()  # 1 for each late step
        self._rewards = array("d")

    def start(self) -> None:
        """Begin an episode. Cuts off an open one.

        Raises:
            LocalProtocolError: there is no run yet.
        """
        self._needs_run()
        self.end(records.Ending.CUTOFF)
        self._begin(records.BEGIN)

    def step(self, action: bytes, reward: float, *, late: bool = False) -> None:
        """Add a step of the open episode: the body of its action, and its reward; `late` as in a recording.

        Raises:
            LocalProtocolError: no episode is open, or the episode exceeds a limit of a recording.
        """
        if not self._in_episode:
            raise LocalProtocolError(_NO_EPISODE)
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
        self._late.append(late)
        self._choices.append(choice)
        self._rewards.append(reward)

    def end(self, ending: records.Ending) -> None:
        """End the open episode. Nothing happens if none is open."""
        self._end(ending)

    def _end(self, ending: records.Ending) -> None:
        self._end_block()
        super()._end(ending)

    def _end_block(self) -> None:
        if self._choices:
            # Compared by their bits: 0.0 and -0.0 are two rewards.
            rewards = np.array(self._rewards, np.float64).view(np.uint64)
            bits, paid = np.unique(rewards, return_inverse=True)
            late = np.packbits(np.frombuffer(bytes(self._late), np.uint8), bitorder="little").tobytes()
            record = (
                records.LATE_BLOCK if any(late) else records.BLOCK,
                records.COUNTS.pack(len(self._choices), len(self._actions), len(bits)),
                *self._actions,
                bits.astype("<u8").tobytes(),
                np.array(self._choices, records.width(len(self._actions))).tobytes(),
                paid.astype(records.width(len(bits))).tobytes(),
                late if any(late) else b"",
            )
            self._grow(b"".join(record))
            self._open = 0
            self._actions.clear()
            self._actions_size = 0
            del self._choices[:], self._rewards[:], self._late[:]


def _body_of(value: AbstractType) -> bytes:
    body = value.body
    if len(body) > limits.MAX_BODY:
        raise LocalProtocolError(
            f"an observation or action of {len(body)} bytes cannot be recorded; {limits.MAX_BODY} are allowed"
        )
    return body
