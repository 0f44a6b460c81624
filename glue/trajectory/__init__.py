"""Trajectories: what happened in the episodes of a task, in a compact file.

    with TrajectoryWriter("corridor.traj") as recording:
        recording.run(Run("corridor", {"length": 21}, task_spec))
        recording.start(observation)
        recording.step(action, reward, observation, terminal)   # a terminal step ends the episode
        ...
    for episode in TrajectoryReader("corridor.traj"):
        print(episode.ending, episode.episode_return)

The file is gzip, and what it unpacks to is records: one letter, then its fields, all little-endian.
docs/trajectories.md has every byte. The packed stream is flushed at the end of every episode, so that a
writer that is killed leaves all whole episodes behind.
"""

from __future__ import annotations

import json
import math
import os
import re
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from types import TracebackType
from typing import Any, Final, Self

from glue.errors import LocalProtocolError
from glue.options import Value
from glue.trajectory.steps import Step, Steps
from glue.trajectory.unpacked import GZIP, Torn, TrajectoryError, Unpacked
from glue.types import AbstractType, Action, Observation

__all__ = [
    "MAGIC",
    "MAX_BODY",
    "MAX_EPISODE",
    "MAX_STEPS",
    "MAX_TEXT",
    "Ending",
    "Episode",
    "Run",
    "Step",
    "TrajectoryError",
    "TrajectoryReader",
    "TrajectoryWriter",
]

MAGIC: Final = b"GLUETRJ1"
MAX_BODY: Final = 16 * 2**20  # bytes of one observation or action
MAX_TEXT: Final = 16 * 2**20  # bytes of one run's JSON, or of one message
MAX_EPISODE: Final = 256 * 2**20  # bytes of all records of one episode and the messages before it, unpacked
MAX_STEPS: Final = 1_000_000  # of one episode; and messages before it
_MAX_RUN_SYNTAX: Final = 2**16  # characters of a run's JSON without the contents of its texts

_RUN, _MESSAGE, _START, _STEP, _TERMINAL_STEP, _CUTOFF, _VOID = b"R", b"M", b"O", b"S", b"T", b"C", b"V"
_LENGTH: Final = struct.Struct("<I")
_REWARD: Final = struct.Struct("<d")
# The closing quote may be missing: a text that never ends is looked at once, not once per quote inside it.
_TEXT_IN_JSON: Final = re.compile(r'"(?:[^"\\]|\\.)*+"?', re.DOTALL)


class Ending(Enum):
    """How an episode ended."""

    TERMINAL = "terminal"  # its last step was terminal
    CUTOFF = "cutoff"  # a step limit, or the experiment, ended it
    VOID = "void"  # a player went away, or the recording stopped: it does not count


_ENDINGS: Final = {_TERMINAL_STEP: Ending.TERMINAL, _CUTOFF: Ending.CUTOFF, _VOID: Ending.VOID}


@dataclass(frozen=True, slots=True)
class Run:
    """Where episodes come from: an environment between its env_init and its env_cleanup.

    Attributes:
        environment: the name `glue-env` knows it by, or "" if nobody knows.
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


@dataclass(frozen=True, slots=True)
class Episode:
    """One episode: the first observation, then its steps.

    `messages` are the texts that the environment was sent since the start of the episode before.
    """

    run: Run
    messages: tuple[str, ...]
    start: Observation
    steps: Sequence[Step]
    ending: Ending

    @property
    def episode_return(self) -> float:
        """The sum of the rewards, added in their order."""
        total = 0.0
        for step in self.steps:
            total += step.reward
        return total


class TrajectoryWriter:
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
        self._write(MAGIC)
        self._flush()

    def run(self, run: Run) -> None:
        """Note which environment the episodes from here on come from. Cuts off an open episode.

        Raises:
            LocalProtocolError: the options are not plain values, the run takes more than `MAX_TEXT`, or
                the recording is closed.
        """
        if self._file.closed:
            raise LocalProtocolError("the recording is closed")
        self.cutoff()
        record = _text_record(_RUN, _run_to_json(run))
        self._messages.clear()
        self._write(record)
        self._has_run = True

    def message(self, text: str) -> None:
        """Note a text that the environment was sent. It is kept with the next episode to start.

        Raises:
            LocalProtocolError: there is no run yet, the text takes more than `MAX_TEXT`, or there are more
                than `MAX_STEPS` of them before an episode.
        """
        self._needs_run()
        if len(self._messages) == MAX_STEPS:
            raise LocalProtocolError(f"more than {MAX_STEPS} messages in a row cannot be recorded")
        self._messages.append(_text_record(_MESSAGE, text))

    def start(self, observation: Observation) -> None:
        """Begin an episode. Cuts off an open one.

        Raises:
            LocalProtocolError: there is no run yet, or the observation takes more than `MAX_BODY`.
        """
        self._needs_run()
        self.cutoff()
        record = b"".join((*self._messages, _START, _body_of(observation)))
        self._messages.clear()
        self._steps = self._size = 0
        self._grow(record)
        self._in_episode = True

    def step(self, action: Action, reward: float, observation: Observation, terminal: bool) -> None:
        """Note a step of the open episode; a terminal step ends it.

        Raises:
            LocalProtocolError: no episode is open, or one of the limits of this module is passed.
        """
        if not self._in_episode:
            raise LocalProtocolError("no episode is open: a recording needs a start before its steps")
        if self._steps == MAX_STEPS:
            raise LocalProtocolError(f"an episode of more than {MAX_STEPS} steps cannot be recorded")
        self._steps += 1
        kind = _TERMINAL_STEP if terminal else _STEP
        self._grow(b"".join((kind, _REWARD.pack(reward), _body_of(action), _body_of(observation))))
        if terminal:
            self._in_episode = False
            self._flush()

    def cutoff(self) -> None:
        """End the open episode without a terminal step. Nothing happens if none is open."""
        self._end(_CUTOFF)

    def void(self) -> None:
        """End the open episode as one that does not count. Nothing happens if none is open."""
        self._end(_VOID)

    def close(self) -> None:
        """Void the open episode and close the file. May be called twice."""
        if self._file.closed:
            return
        self.void()
        self._store(self._pack.flush())
        self._shut()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

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
        if self._size > MAX_EPISODE:
            raise LocalProtocolError(f"an episode of more than {MAX_EPISODE} bytes cannot be recorded")
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


class TrajectoryReader:
    """The episodes of a file, one after the other; iterate over it.

    Trusts nothing: sizes are checked against the limits of this module before memory is taken for
    them, and an episode is the most that is held at a time. Each iteration reads the file anew.

    Attributes:
        torn: whether the file ends in the middle, as a writer that was killed leaves it; known once
            the last episode was read. The episode it was in is left out.

    Raises, while iterating:
        TrajectoryError: the file cannot be read or is malformed; the message has the place.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = Path(path)
        self.torn = False

    def __iter__(self) -> Iterator[Episode]:
        self.torn = False
        try:
            with open(self.path, "rb") as file:
                unpacked = Unpacked(file, str(self.path))
                while unpacked.next_member(MAGIC):
                    yield from _episodes(unpacked)
        except Torn:
            self.torn = True
        except OSError as error:
            raise TrajectoryError(f"cannot read {self.path}: {error.strerror}") from None


def _episodes(unpacked: Unpacked) -> Iterator[Episode]:
    """Yield the episodes of one gzip member."""
    run: Run | None = None
    messages: list[str] = []
    while not unpacked.at_end():
        if not messages:
            begin = unpacked.offset
        kind = unpacked.take(1)
        if kind == _RUN:
            run = _run_from_json(unpacked)
            messages.clear()
        elif kind == _MESSAGE and run is not None:
            messages.append(unpacked.text(MAX_TEXT))
            _check_size(unpacked, begin, len(messages))
        elif kind == _START and run is not None:
            yield _episode(unpacked, run, tuple(messages), begin)
            messages.clear()
        else:
            raise unpacked.malformed(f"a record {kind!r} where none of that kind can stand")


def _episode(unpacked: Unpacked, run: Run, messages: tuple[str, ...], begin: int) -> Episode:
    """Read an episode from its first observation on; `begin` is where it or its first message begins."""
    start = Observation.from_body(unpacked.body(MAX_BODY))
    steps = Steps()
    while (kind := unpacked.take(1)) in (_STEP, _TERMINAL_STEP):
        reward = unpacked.take(_REWARD.size)
        action, observation = unpacked.body(MAX_BODY), unpacked.body(MAX_BODY)
        steps.append(reward, action, observation, kind == _TERMINAL_STEP)
        _check_size(unpacked, begin, len(steps))
        if kind == _TERMINAL_STEP:
            break
    if kind not in _ENDINGS:
        raise unpacked.malformed(f"a record {kind!r} inside an episode")
    return Episode(run, messages, start, steps, _ENDINGS[kind])


def _check_size(unpacked: Unpacked, begin: int, count: int) -> None:
    if count > MAX_STEPS or unpacked.offset - begin > MAX_EPISODE:
        raise unpacked.malformed(
            f"an episode of more than {MAX_STEPS} steps or messages, or of more than {MAX_EPISODE} bytes"
        )


def _body_of(value: AbstractType) -> bytes:
    body = value.body
    if len(body) > MAX_BODY:
        raise LocalProtocolError(
            f"an observation or action of {len(body)} bytes cannot be recorded; {MAX_BODY} are allowed"
        )
    return body


def _text_record(kind: bytes, text: str) -> bytes:
    try:
        encoded = text.encode()
    except UnicodeEncodeError as error:
        raise LocalProtocolError(f"a text that is not Unicode cannot be recorded: {error}") from None
    if len(encoded) > MAX_TEXT:
        raise LocalProtocolError(f"a text of {len(encoded)} bytes cannot be recorded; {MAX_TEXT} are allowed")
    return kind + _LENGTH.pack(len(encoded)) + encoded


def _run_to_json(run: Run) -> str:
    for name, value in run.options.items():
        if not _is_plain(value):
            raise LocalProtocolError(f"option {name} cannot be recorded: {value!r} is not a plain value")
    return json.dumps(
        {
            "environment": run.environment,
            "options": dict(run.options),
            "task_spec": run.task_spec,
            "seed": run.seed,
            "state": run.state.hex(),
        }
    )


def _run_from_json(unpacked: Unpacked) -> Run:
    text = unpacked.text(MAX_TEXT)
    # 16 MiB of "[]," would become half a gigabyte of lists; a run has few values, some of them long texts.
    if len(_TEXT_IN_JSON.sub("", text)) > _MAX_RUN_SYNTAX:
        raise unpacked.malformed(
            f"a run whose JSON has more than {_MAX_RUN_SYNTAX} characters beside its texts"
        )
    try:
        fields: Any = json.loads(text)
        run = Run(
            environment=fields["environment"],
            options=fields["options"],
            task_spec=fields["task_spec"],
            seed=fields["seed"],
            state=bytes.fromhex(fields["state"]),
        )
    except (ValueError, TypeError, KeyError, RecursionError) as error:
        raise unpacked.malformed(f"a run that is not the JSON it should be ({error!r})") from None
    if not (
        isinstance(run.environment, str)
        and isinstance(run.options, dict)
        and all(map(_is_plain, run.options.values()))
        and isinstance(run.task_spec, str)
        and (run.seed is None or (type(run.seed) is int and 0 <= run.seed < 2**63))
    ):
        raise unpacked.malformed("a run with a field of the wrong type")
    return run


def _is_plain(value: object) -> bool:
    return type(value) in (int, str, bool) or (type(value) is float and math.isfinite(value))
