"""Read recordings, episode by episode, without trusting them: in pieces, within their limits."""

from __future__ import annotations

import json
import os
import re
import zlib
from array import array
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
import numpy.typing as npt

from glue.errors import GlueError
from glue.files import open_regular
from glue.trajectory import limits, records
from glue.types import PREFIX_SIZE, Observation, body_size, has_beside

GZIP: Final = 31  # zlib's number for "with gzip's header and checksum"
_PIECE: Final = 2**16  # bytes read, and unpacked, at a time


class TrajectoryError(GlueError):
    """A recording cannot be read or written; the message says where it goes wrong."""


class Torn(Exception):
    """The file ended before its gzip stream did."""


class Unpacked:
    """The contents of a gzip file, read member by member in pieces of known length."""

    def __init__(self, file: BinaryIO, name: str) -> None:
        self._file = file
        self._name = name
        self._packed = b""
        self._gzip = zlib.decompressobj(GZIP)
        self._bytes = bytearray()
        self._at = 0  # offset of the next byte, in self._bytes
        self._gone = 0  # number of bytes before self._bytes

    def next_member(self, magic: bytes) -> bool:
        """Begin the next gzip stream of the file, which must begin with `magic`; False if there is none."""
        self._packed = self._packed or self._file.read(_PIECE)
        if self.offset and not self._packed:
            return False
        self._gzip = zlib.decompressobj(GZIP)
        try:
            found = self.take(len(magic))
        except Torn:
            found = b""
        if found != magic:
            raise self.malformed(f"it does not unpack to {magic.decode()} and records")
        return True

    def at_end(self) -> bool:
        """Return whether this member has been read to its end."""
        return self._at == len(self._bytes) and not self._unpack()

    def take(self, size: int) -> bytes:
        """Return the next `size` bytes.

        Raises:
            TrajectoryError: the member ends before that.
            Torn: the file ends before that.
        """
        self._fill(size)
        self._at += size
        return bytes(self._bytes[self._at - size : self._at])

    def body(self, limit: int) -> bytes:
        """Return the next abstract type's body, of at most `limit` bytes."""
        self._fill(PREFIX_SIZE)
        try:
            size = body_size(self._bytes, self._at)
        except GlueError as error:
            raise self.malformed(str(error)) from None
        if size > limit:
            raise self.malformed(f"an observation or action of {size} bytes; {limit} are allowed")
        return self.take(size)

    def action(self, limit: int) -> bytes:
        """Return the next abstract type's body like `body`, of an action."""
        body = self.body(limit)
        if has_beside(body):
            raise self.malformed("an action with a mask or extras, which only an observation can have")
        return body

    def text(self, limit: int) -> str:
        """Return the next length and text, of at most `limit` bytes."""
        (size,) = records.LENGTH.unpack(self.take(records.LENGTH.size))
        if size > limit:
            raise self.malformed(f"a text of {size} bytes; {limit} are allowed")
        try:
            return self.take(size).decode()
        except UnicodeDecodeError:
            raise self.malformed("a text that is not UTF-8") from None

    @property
    def offset(self) -> int:
        """Number of unpacked bytes taken so far."""
        return self._gone + self._at

    def malformed(self, what: str) -> TrajectoryError:
        """Return the error that says what is wrong, and where."""
        return TrajectoryError(
            f"{self._name} cannot be read as a recording: {what} "
            f"(before byte {self.offset} of what it unpacks to)"
        )

    def _fill(self, size: int) -> None:
        """Unpack until the next `size` bytes are in memory."""
        while len(self._bytes) - self._at < size:
            if not self._unpack():
                raise self.malformed("it ends inside a record")

    def _unpack(self) -> bool:
        """Unpack at least one more byte; return False if the member has ended."""
        while not self._gzip.eof:
            if not self._packed:
                self._packed = self._file.read(_PIECE)
                if not self._packed:
                    raise Torn
            try:
                piece = self._gzip.decompress(self._packed, _PIECE)
            except zlib.error as error:
                raise self.malformed(f"gzip cannot unpack it ({error})") from None
            self._packed = self._gzip.unused_data if self._gzip.eof else self._gzip.unconsumed_tail
            if piece:
                del self._bytes[: self._at]
                self._gone += self._at
                self._at = 0
                self._bytes += piece
                return True
        return False


# The closing quote may be missing: a text that never ends is scanned once, not once per quote inside it.
_TEXT_IN_JSON: Final = re.compile(r'"(?:[^"\\]|\\.)*+"?', re.DOTALL)


class TrajectoryReader:
    """Iterable over the episodes of a file.

    Nothing is trusted: sizes are checked against `glue.trajectory.limits` before allocating memory for them,
    and at most one episode is held at a time. Each iteration reads the file from its beginning.

    Attributes:
        torn: whether the file ends in the middle, as a writer that was killed leaves it; known once
            the last episode has been read. An incomplete episode is left out.

    Raises, while iterating:
        TrajectoryError: the file cannot be read or is malformed; the message says where.
    """

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path: Path = Path(path)
        self.torn: bool = False

    def __iter__(self) -> Iterator[records.Episode]:
        self.torn = False
        try:
            with open_regular(self.path) as file:
                unpacked = Unpacked(file, str(self.path))
                while unpacked.next_member(records.MAGIC):
                    yield from _episodes(unpacked)
        except Torn:
            self.torn = True
        except OSError as error:
            raise TrajectoryError(f"cannot read {self.path}: {error.strerror}") from None


def _episodes(unpacked: Unpacked) -> Iterator[records.Episode]:
    """Yield the episodes of one gzip member."""
    run: records.Run | None = None
    messages: list[str] = []
    answers: list[records.Answer] = []
    while not unpacked.at_end():
        if not messages and not answers:
            begin = unpacked.offset
        kind = unpacked.take(1)
        if kind == records.RUN:
            run = _run_from_json(unpacked)
            messages.clear()
            answers.clear()
        elif kind == records.MESSAGE and run is not None:
            messages.append(unpacked.text(limits.MAX_TEXT))
            _check_size(unpacked, begin, len(messages))
        elif kind == records.ANSWER and run is not None:
            answers.append(_answer(unpacked, 0))
            _check_size(unpacked, begin, len(answers))
        elif kind in (records.START, records.BEGIN) and run is not None:
            read = _episode if kind == records.START else _actions_only
            yield read(unpacked, run, tuple(messages), answers, begin)
            messages.clear()
            answers = []
        else:
            raise unpacked.malformed(f"a record {kind!r} where none of that kind can stand")


def _episode(
    unpacked: Unpacked, run: records.Run, messages: tuple[str, ...], answers: list[records.Answer], begin: int
) -> records.Episode:
    """Read an episode from its first observation; `begin` is the offset of its first record."""
    start = Observation.from_body(unpacked.body(limits.MAX_BODY))
    steps, late = records.Steps(), array("I")
    while (kind := unpacked.take(1)) in (records.STEP, records.TERMINAL_STEP, records.ANSWER, records.LATE):
        if kind == records.ANSWER:
            answers.append(_answer(unpacked, len(steps) + 1))
            _check_size(unpacked, begin, len(answers))
            continue
        if kind == records.LATE:
            late.append(len(steps) + 1)
            if (kind := unpacked.take(1)) not in (records.STEP, records.TERMINAL_STEP):
                raise unpacked.malformed(f"a record {kind!r} where a step is to follow")
        reward = unpacked.take(records.REWARD.size)
        action, observation = unpacked.action(limits.MAX_BODY), unpacked.body(limits.MAX_BODY)
        steps.append(reward, action, observation, kind == records.TERMINAL_STEP)
        _check_size(unpacked, begin, len(steps))
        if kind == records.TERMINAL_STEP:
            break
    ending = records.Ending.TERMINAL if kind == records.TERMINAL_STEP else records.ENDINGS.get(kind)
    if ending is None or kind == records.TERMINAL_END or (answers and answers[-1].step > len(steps)):
        raise unpacked.malformed(f"a record {kind!r} inside an episode")
    return records.Episode(run, messages, start, steps, ending, tuple(answers), late or ())


def _actions_only(
    unpacked: Unpacked, run: records.Run, messages: tuple[str, ...], answers: list[records.Answer], begin: int
) -> records.Episode:
    """Read an episode without observations; `begin` is the offset of its first record."""
    steps, late = records.ActionSteps(), array("I")
    while (kind := unpacked.take(1)) in (records.BLOCK, records.LATE_BLOCK):
        before = len(steps)
        steps.append(_block(unpacked, begin + limits.MAX_EPISODE))
        if kind == records.LATE_BLOCK:
            count = len(steps) - before
            bits = np.frombuffer(unpacked.take((count + 7) // 8), np.uint8)
            places = np.flatnonzero(np.unpackbits(bits, count=count, bitorder="little"))
            late.frombytes((places + before + 1).astype(np.uintc).tobytes())
        _check_size(unpacked, begin, len(steps.blocks))  # a block takes far more memory than bytes
    if kind not in records.ENDINGS or (kind == records.TERMINAL_END and not steps):
        raise unpacked.malformed(f"a record {kind!r} inside an episode")
    steps.end(kind == records.TERMINAL_END)
    return records.Episode(run, messages, None, steps, records.ENDINGS[kind], tuple(answers), late or ())


def _block(unpacked: Unpacked, end: int) -> records.Block:
    """Read a block of steps, whose actions may not pass the offset `end`."""
    steps, k, m = records.COUNTS.unpack(unpacked.take(records.COUNTS.size))
    if not (1 <= steps <= limits.MAX_BLOCK and 1 <= k <= steps and 1 <= m <= steps):
        raise unpacked.malformed(f"a block of {steps} steps with {k} actions and {m} rewards")
    actions = []
    for _ in range(k):
        actions.append(unpacked.action(limits.MAX_BODY))
        if unpacked.offset > end:
            raise unpacked.malformed(f"an episode of more than {limits.MAX_EPISODE} bytes")

    def column(dtype: str, count: int) -> npt.NDArray[Any]:
        return np.frombuffer(unpacked.take(count * np.dtype(dtype).itemsize), dtype)

    rewards = column("<f8", m)
    choices, paid = column(records.width(k), steps), column(records.width(m), steps)
    if choices.max() >= k or paid.max() >= m:
        raise unpacked.malformed("a step with an action or reward that its block does not have")
    return records.Block(tuple(actions), choices, rewards[paid])


def _answer(unpacked: Unpacked, step: int) -> records.Answer:
    return records.Answer(step, unpacked.text(limits.MAX_TEXT), unpacked.text(limits.MAX_TEXT))


def _check_size(unpacked: Unpacked, begin: int, count: int) -> None:
    if count > limits.MAX_STEPS or unpacked.offset - begin > limits.MAX_EPISODE:
        raise unpacked.malformed(
            f"an episode of more than {limits.MAX_STEPS} steps, blocks, messages or answers, or of more than "
            f"{limits.MAX_EPISODE} bytes"
        )


def _run_from_json(unpacked: Unpacked) -> records.Run:
    text = unpacked.text(limits.MAX_TEXT)
    # 16 MiB of "[]," would become half a gigabyte of lists; a run has few values, some of them long texts.
    if len(_TEXT_IN_JSON.sub("", text)) > limits.MAX_RUN_SYNTAX:
        raise unpacked.malformed(
            f"a run whose JSON has more than {limits.MAX_RUN_SYNTAX} characters outside its texts"
        )
    try:
        fields: Any = json.loads(text)
        run = records.Run(
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
        and all(map(records.is_plain, run.options.values()))
        and isinstance(run.task_spec, str)
        and (run.seed is None or (type(run.seed) is int and 0 <= run.seed < 2**63))
    ):
        raise unpacked.malformed("a run with a field of the wrong type")
    return run
