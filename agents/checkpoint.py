"""What was learned, as bytes and back. No pickle: numbers, and arrays of numbers.

    offset  0   8 bytes    magic
    offset  8   uint32     version of this format, 1
    offset 12   uint32     H, bytes of header
    offset 16   H bytes    JSON: agent, settings, numbers, and [name, dtype, count] of every array
    then        arrays     one after another, nothing in between
    at the end  32 bytes   SHA-256 of all before it

Everything is little-endian, and equal contents give equal bytes.
"""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glue.errors import GlueError

__all__ = ["Checkpoint", "CheckpointError", "pack", "unpack"]

_MAGIC: Final = b"GLUEAGNT"
_VERSION: Final = 1
_HEAD: Final = struct.Struct("<8sII")
_DIGEST_SIZE: Final = hashlib.sha256().digest_size
_MAX_HEADER: Final = 1 << 16
_MAX_SIZE: Final = 1 << 30
_DTYPES: Final = frozenset({"<u8", "<i8", "<f8", "|i1"})

Setting = int | float | str | bool


class CheckpointError(GlueError):
    """A checkpoint is damaged, or of another agent or other settings; the message says which."""


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """What an agent saves.

    agent     its name
    settings  the options without which the values make no sense
    numbers   generator state and counters
    arrays    one-dimensional arrays of uint64, int64, float64 or int8
    """

    agent: str
    settings: Mapping[str, Setting]
    numbers: Mapping[str, int]
    arrays: Mapping[str, npt.NDArray[Any]]


def pack(checkpoint: Checkpoint) -> bytes:
    """Return a checkpoint as bytes."""
    runs = {
        name: array.astype(array.dtype.newbyteorder("<"), copy=False)
        for name, array in sorted(checkpoint.arrays.items())
    }
    header = json.dumps(
        {
            "agent": checkpoint.agent,
            "settings": dict(checkpoint.settings),
            "numbers": dict(checkpoint.numbers),
            "arrays": [[name, array.dtype.str, len(array)] for name, array in runs.items()],
        },
        sort_keys=True,
    ).encode()
    head = _HEAD.pack(_MAGIC, _VERSION, len(header))
    data = b"".join((head, header, *(array.tobytes() for array in runs.values())))
    return data + hashlib.sha256(data).digest()


def unpack(data: bytes, agent: str, settings: Mapping[str, Setting]) -> Checkpoint:
    """Return the checkpoint that `pack` made, for an agent of this name and these settings.

    Raises:
        CheckpointError: it is too long, damaged, of another version, agent or settings.
    """
    if len(data) > _MAX_SIZE:
        raise CheckpointError(f"a checkpoint has at most {_MAX_SIZE} bytes; {len(data)} came")
    if len(data) < _HEAD.size + _DIGEST_SIZE or not data.startswith(_MAGIC):
        raise CheckpointError("this is not a saved agent: it does not begin as one")
    _, version, header_size = _HEAD.unpack_from(data)
    if version != _VERSION:
        raise CheckpointError(f"this saved agent is of format {version}; {_VERSION} is what can be read")
    contents, digest = data[:-_DIGEST_SIZE], data[-_DIGEST_SIZE:]
    if hashlib.sha256(contents).digest() != digest:
        raise CheckpointError("this saved agent is damaged: its digest does not match its contents")
    if header_size > _MAX_HEADER:
        raise CheckpointError(f"a header has at most {_MAX_HEADER} bytes; one of {header_size} came")
    try:
        checkpoint = _read(contents[_HEAD.size :], header_size)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise CheckpointError(f"this saved agent is not well formed: {error}") from None
    _check_origin(checkpoint, agent, settings)
    return checkpoint


def _read(contents: bytes, header_size: int) -> Checkpoint:
    """Return the checkpoint of a header and its arrays; any error means that it is not well formed."""
    header = json.loads(contents[:header_size])
    arrays: dict[str, npt.NDArray[Any]] = {}
    offset = header_size
    for name, dtype, count in header["arrays"]:
        if dtype not in _DTYPES or type(count) is not int or count < 0:
            raise ValueError(f"array {name!r} of {count!r} {dtype!r}")
        arrays[str(name)] = np.frombuffer(contents, dtype, count, offset).copy()
        offset += arrays[str(name)].nbytes
    if offset != len(contents):
        raise ValueError(f"{len(contents) - offset} bytes beyond its arrays")
    numbers = {str(name): int(number) for name, number in header["numbers"].items()}
    return Checkpoint(str(header["agent"]), dict(header["settings"]), numbers, arrays)


def _check_origin(checkpoint: Checkpoint, agent: str, settings: Mapping[str, Setting]) -> None:
    if checkpoint.agent != agent:
        raise CheckpointError(f"this was saved by agent {checkpoint.agent}, and cannot be loaded by {agent}")
    if checkpoint.settings != settings:
        saved = ", ".join(f"{name}={value}" for name, value in sorted(checkpoint.settings.items()))
        raise CheckpointError(
            f"this agent was saved with the options {saved}: load it into one started with the same"
        )
