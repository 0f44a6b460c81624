"""Write recordings, record by record."""

from __future__ import annotations

import os
import zlib
from contextlib import suppress
from pathlib import Path

from glue.closing import Closing
from glue.errors import LocalProtocolError
from glue.trajectory import limits
from glue.trajectory.records import (
    ANSWER,
    CUTOFF,
    MAGIC,
    MESSAGE,
    REWARD,
    START,
    STEP,
    TERMINAL_STEP,
    VOID,
    Run,
    run_record,
    text_record,
)
from glue.trajectory.unpacked import GZIP, TrajectoryError
from glue.types import AbstractType, Action, Observation


class TrajectoryWriter(Closing):
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
        self._pack = zlib.compressobj(wbits=GZIP)
        self._has_run = False
        self._in_episode = False
        self._steps = 0
        self._size = 0
        self._messages: list[bytes] = []
        self._answers: list[bytes] = []
        self._answered = 0  # in the open episode
        self._write(MAGIC)
        self._flush()

    def run(self, run: Run) -> None:
        """Record the environment that the following episodes come from. Cuts off an open episode.

        Raises:
            LocalProtocolError: the options are not plain values, the run takes more than `MAX_TEXT`, or
                the recording is closed.
        """
        if self._file.closed:
            raise LocalProtocolError("the recording is closed")
        self.cutoff()
        record = run_record(run)
        self._messages.clear()
        self._answers.clear()
        self._write(record)
        self._has_run = True

    def message(self, text: str) -> None:
        """Record a text that was sent to the environment, with the next episode to start.

        Raises:
            LocalProtocolError: there is no run yet, the text takes more than `MAX_TEXT`, or there are more
                than `MAX_STEPS` of them before an episode.
        """
        self._needs_run()
        if len(self._messages) == limits.MAX_STEPS:
            raise LocalProtocolError(f"more than {limits.MAX_STEPS} messages in a row cannot be recorded")
        self._messages.append(text_record(MESSAGE, text))

    def answer(self, message: str, answer: str) -> None:
        """Record the agent's answer to a message at the start or step that is recorded next.

        Raises:
            LocalProtocolError: there is no run yet, a text takes more than `MAX_TEXT`, or there are more
                than `MAX_STEPS` answers in an episode.
        """
        self._needs_run()
        if self._answered + len(self._answers) == limits.MAX_STEPS:
            raise LocalProtocolError(f"more than {limits.MAX_STEPS} answers in an episode cannot be recorded")
        self._answers.append(text_record(ANSWER, message) + text_record(b"", answer))

    def start(self, observation: Observation) -> None:
        """Begin an episode. Cuts off an open one.

        Raises:
            LocalProtocolError: there is no run yet, or the observation takes more than `MAX_BODY`.
        """
        self._needs_run()
        self.cutoff()
        record = b"".join((*self._messages, *self._answers, START, _body_of(observation)))
        self._messages.clear()
        self._steps = self._size = 0
        self._answered = len(self._answers)
        self._answers.clear()
        self._grow(record)
        self._in_episode = True

    def step(self, action: Action, reward: float, observation: Observation, terminal: bool) -> None:
        """Record a step of the open episode; a terminal step ends it.

        Raises:
            LocalProtocolError: no episode is open, or a limit of `glue.trajectory.limits` is exceeded.
        """
        if not self._in_episode:
            raise LocalProtocolError("no episode is open: a recording needs a start before its steps")
        if self._steps == limits.MAX_STEPS:
            raise LocalProtocolError(f"an episode of more than {limits.MAX_STEPS} steps cannot be recorded")
        self._steps += 1
        kind = TERMINAL_STEP if terminal else STEP
        fields = (REWARD.pack(reward), _body_of(action), _body_of(observation))
        self._grow(b"".join((*self._answers, kind, *fields)))
        self._answered += len(self._answers)
        self._answers.clear()
        if terminal:
            self._in_episode = False
            self._flush()

    def cutoff(self) -> None:
        """End the open episode without a terminal step. Nothing happens if none is open."""
        self._end(CUTOFF)

    def void(self) -> None:
        """End the open episode as one that does not count. Nothing happens if none is open."""
        self._end(VOID)

    def close(self) -> None:
        """Void the open episode and close the file. May be called twice."""
        if self._file.closed:
            return
        self.void()
        self._store(self._pack.flush())
        self._shut()

    def _needs_run(self) -> None:
        if not self._has_run:
            raise LocalProtocolError("no run is open: a recording starts with run() and ends with close()")

    def _end(self, kind: bytes) -> None:
        if self._in_episode:
            self._in_episode = False
            self._write(kind)
            self._flush()

    def _grow(self, record: bytes) -> None:
        self._size += len(record)
        if self._size > limits.MAX_EPISODE:
            raise LocalProtocolError(f"an episode of more than {limits.MAX_EPISODE} bytes cannot be recorded")
        self._write(record)

    def _write(self, record: bytes) -> None:
        packed = self._pack.compress(record)
        if packed:
            self._store(packed)

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


def _body_of(value: AbstractType) -> bytes:
    body = value.body
    if len(body) > limits.MAX_BODY:
        raise LocalProtocolError(
            f"an observation or action of {len(body)} bytes cannot be recorded; {limits.MAX_BODY} are allowed"
        )
    return body
