"""The record of a trial: every action and every reward, from which its score can be computed again.

A file begins with 8 bytes that name the format, and goes on with frames; it is only ever appended to.

    frame    length of the rest (u32), CRC-32 of the rest (u32), the rest: zlib's format
    first    JSON: the trial's id, and the version of this format
    others   steps, at most `MAX_STEPS`, of several episodes or of a part of one:
             p parts (u32), n steps (u32), k different actions (u32), m different rewards (u32),
             p lengths (u32) and p ends (u8, see `End`) of the parts,
             k lengths (u32), the k actions (bodies of the protocol), the m rewards (f64),
             which action was executed in each step (n integers of one, two or four bytes, as k needs),
             which reward was paid for it (n integers, as m needs)

All numbers are little-endian. A step of Infinite Mario takes about one byte. What a process that was killed
leaves after the last frame is no frame: its length or its checksum is wrong.

The organiser's database holds the SHA-256 of each finished record, so that no byte of it can change unseen.
"""

from __future__ import annotations

import hashlib
import json
import os
import struct
import zlib
from array import array
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from enum import IntEnum
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np
import numpy.typing as npt

from experiment_runner.store.database import reported
from experiment_runner.store.layout import RECORDS
from glue.closing import Closing
from glue.errors import ExperimentError

__all__ = [
    "MAX_STEPS",
    "End",
    "Part",
    "PartWriter",
    "RecordError",
    "RecordFile",
    "digest",
    "header",
    "read_parts",
    "record_path",
]

MAX_STEPS: Final = 65_536
"""The most steps in a frame; a longer episode has several parts."""

_MAX_PARTS: Final = MAX_STEPS + 1
"""The most parts in a frame; the last may be empty."""

_ENOUGH_STEPS: Final = 8_192
"""Steps after which a frame ends with the episode."""

_MAX_ACTIONS_SIZE: Final = 2**23
"""Bytes of different actions after which a frame ends early."""

_MAX_CONTENT: Final = 2**26
"""Bytes of a frame before compression, at most: one action may have 16 MiB."""

_MAGIC: Final = b"\x89GLPLAY\n"
_VERSION: Final = 1
_FRAME: Final = struct.Struct("<II")
_COUNTS: Final = struct.Struct("<IIII")
_LEVEL: Final = 6  # of compression

_HINT: Final = "; solve that, and start the same command again: what was recorded is kept"

Indices = npt.NDArray[np.unsignedinteger[Any]]


class RecordError(ExperimentError):
    """A record is damaged, or was changed."""


class End(IntEnum):
    """How a part of an episode ends."""

    GOES_ON = 0  # the next part continues it
    TERMINAL = 1  # the environment ended the episode
    CUT_OFF = 2  # the task's steps were used up
    FORFEIT = 3  # the entrant's time or program ended in the middle of it


@dataclass(frozen=True, slots=True)
class Part:
    """A part of an episode.

    Args:
        end: how it ends.
        actions: the bodies of the different actions, shape (k,).
        choices: which of them was executed in each step, shape (n,).
        rewards: what was paid, shape (n,).
    """

    end: End
    actions: tuple[bytes, ...]
    choices: Indices
    rewards: npt.NDArray[np.float64]


class PartWriter:
    """Collects the steps of a trial, and hands them over in frames.

    Args:
        send: takes a frame.
    """

    def __init__(self, send: Callable[[bytes], None]) -> None:
        self._send = send
        self._actions: dict[bytes, int] = {}
        self._size = 0
        self._begins = 0
        self._lengths = array("I")
        self._ends = array("B")
        self._choices = array("I")
        self._rewards = array("d")

    def step(self, action: bytes, reward: float) -> None:
        """Add a step: the body of an action, and the reward for it."""
        if len(self._choices) >= MAX_STEPS or self._size >= _MAX_ACTIONS_SIZE:
            self._part(End.GOES_ON)
            self.flush()
        choice = self._actions.get(action)
        if choice is None:
            choice = self._actions[action] = len(self._actions)
            self._size += len(action)
        self._choices.append(choice)
        self._rewards.append(reward)

    def end(self, end: End) -> None:
        """End an episode."""
        self._part(end)
        if len(self._choices) >= _ENOUGH_STEPS:
            self.flush()

    def flush(self) -> None:
        """Hand over the episodes that have ended since the last frame."""
        if self._ends:
            self._send(
                _frame(_encode(self._lengths, self._ends, tuple(self._actions), self._choices, self._rewards))
            )
            self._actions.clear()
            self._size = self._begins = 0
            for column in (self._lengths, self._ends, self._choices, self._rewards):
                del column[:]

    def _part(self, end: End) -> None:
        self._lengths.append(len(self._choices) - self._begins)
        self._ends.append(end)
        self._begins = len(self._choices)


def header(trial_id: str) -> bytes:
    """Return how the record of a trial begins."""
    return _MAGIC + _frame(json.dumps({"trial": trial_id, "version": _VERSION}).encode())


class RecordFile(Closing):
    """A record that is being written.

    Args:
        path: of the file; a record that was left there is replaced.
        trial_id: of the trial.

    Raises:
        StorageError: it cannot be written.
    """

    def __init__(self, path: Path, trial_id: str) -> None:
        self._path = path
        self._hash = hashlib.sha256()
        with reported(f"cannot write {path}", _HINT):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file: BinaryIO = path.open("wb")
        self.append(header(trial_id))

    def append(self, frame: bytes) -> None:
        """Append a frame.

        Raises:
            StorageError: it cannot be written.
        """
        with reported(f"cannot write {self._path}", _HINT):
            self._file.write(frame)
            self._file.flush()
        self._hash.update(frame)

    def finish(self) -> bytes:
        """Flush the record to the disk, and close it; return its SHA-256.

        Raises:
            StorageError: it cannot be written.
        """
        with reported(f"cannot write {self._path}", _HINT):
            os.fsync(self._file.fileno())
        self.close()
        return self._hash.digest()

    def close(self) -> None:
        """Close the file as it is."""
        self._file.close()


def record_path(directory: Path, trial_id: str) -> Path:
    """Return where a run has the record of a trial."""
    return directory / RECORDS / f"{trial_id}.plays"


def digest(path: Path) -> bytes:
    """Return the SHA-256 of a record.

    Raises:
        StorageError: it cannot be read.
    """
    with reported(f"cannot read {path}"), path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").digest()


def read_parts(path: Path, trial_id: str) -> Iterator[Part]:
    """Yield the parts of a trial's record; at most one is in memory.

    Raises:
        RecordError: it is not the record of this trial, or is damaged; what precedes the damage is intact.
        StorageError: it cannot be read.
    """
    with reported(f"cannot read {path}"), path.open("rb") as file:
        begins = header(trial_id)
        if file.read(len(begins)) != begins:
            raise RecordError(f"{path} is not the record of {trial_id}")
        while start := file.read(_FRAME.size):
            if len(start) < _FRAME.size:
                raise RecordError(f"{path} ends in the middle of a frame")
            length, checksum = _FRAME.unpack(start)
            packed = file.read(length) if length <= _MAX_CONTENT else b""
            if len(packed) < length:
                raise RecordError(f"{path} ends in the middle of a frame, or a length in it is wrong")
            if zlib.crc32(packed) != checksum:
                raise RecordError(f"{path}: the checksum of a frame is wrong")
            try:
                parts = _decode(_unpack(packed))
            except (ValueError, struct.error, zlib.error) as error:
                raise RecordError(f"{path}: a frame holds no steps ({error})") from error
            yield from parts


def _frame(content: bytes) -> bytes:
    packed = zlib.compress(content, _LEVEL)
    return _FRAME.pack(len(packed), zlib.crc32(packed)) + packed


def _unpack(packed: bytes) -> bytes:
    unpacker = zlib.decompressobj()
    content = unpacker.decompress(packed, _MAX_CONTENT)
    if not unpacker.eof or unpacker.unused_data:
        raise ValueError("it is too large, or not compressed as it should be")
    return content


def _encode(
    lengths: array[int],
    ends: array[int],
    actions: Sequence[bytes],
    choices: array[int],
    rewards: array[float],
) -> bytes:
    # By their bits: 0.0 and -0.0 are two rewards.
    bits, paid = np.unique(np.array(rewards, np.float64).view(np.uint64), return_inverse=True)
    parts = [
        _COUNTS.pack(len(ends), len(choices), len(actions), len(bits)),
        np.array(lengths, "<u4").tobytes(),
        ends.tobytes(),
        np.array([len(action) for action in actions], "<u4").tobytes(),
        *actions,
        bits.astype("<u8").tobytes(),
        np.array(choices, _width(len(actions))).tobytes(),
        paid.astype(_width(len(bits))).tobytes(),
    ]
    return b"".join(parts)


def _decode(content: bytes) -> list[Part]:
    p, n, k, m = _COUNTS.unpack_from(content)
    if p > _MAX_PARTS or n > MAX_STEPS or k > n or m > n:
        raise ValueError("it counts more than a frame may have")
    place = _COUNTS.size

    def take(dtype: str, count: int) -> npt.NDArray[Any]:
        nonlocal place
        values = np.frombuffer(content, dtype, count, place) if count else np.empty(0, dtype)
        place += values.nbytes
        return values

    lengths, ends, sizes = take("<u4", p), take("u1", p), take("<u4", k)
    if int(lengths.sum()) != n or int(sizes.sum()) > len(content):
        raise ValueError("its lengths do not add up")
    actions = tuple(take("u1", size).tobytes() for size in sizes.tolist())
    rewards = take("<f8", m)
    choices = take(_width(k), n)
    paid = take(_width(m), n)
    if place != len(content):
        raise ValueError("it is longer than its numbers")
    if n and (int(choices.max()) >= k or int(paid.max()) >= m):
        raise ValueError("it names an action or a reward that it does not have")
    cuts = np.cumsum(lengths)[:-1]
    split = zip(ends.tolist(), np.split(choices, cuts), np.split(rewards[paid], cuts), strict=True)
    return [Part(End(end), actions, chosen, got) for end, chosen, got in split] if p else []


def _width(count: int) -> str:
    """Return the smallest type of integers that counts so far."""
    return "<u1" if count <= 2**8 else "<u2" if count <= 2**16 else "<u4"
