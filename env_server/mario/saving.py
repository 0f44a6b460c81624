"""The state of Infinite Mario that outlives an episode, as `env_save` returns it.

It consists of the level, the four buttons at the end of the last episode, and whether an episode has begun.
"""

from __future__ import annotations

import struct
import zlib
from typing import Final, NamedTuple

import numpy as np

from glue.errors import SaveError
from glue.saves import Arrays, Saved, is_packed, pack, unpack

_NAME: Final = "mario"

# Earlier versions saved this record and a CRC-32 of it.
_OLD: Final = struct.Struct("<8sqii5?")
_OLD_CHECKSUM: Final = struct.Struct("<I")
_OLD_MAGIC: Final = b"mario\0\0\1"


class State(NamedTuple):
    """The level's seed, type and difficulty; left, right, jump and run; whether an episode has begun."""

    level: tuple[int, ...]
    buttons: tuple[bool, ...]
    started: bool


def pack_state(state: State) -> bytes:
    """Return `state` as bytes."""
    arrays: Arrays = {"level": np.array(state.level, np.int64), "buttons": np.array(state.buttons, np.int8)}
    return pack(Saved(_NAME, {}, {"started": int(state.started)}, arrays))


def unpack_state(data: bytes) -> State:
    """Return the state that `pack_state` packed; the level's numbers are not checked yet.

    Raises:
        SaveError: `data` is damaged, of another environment or of another version.
    """
    return _unpack(data) if is_packed(data) else _unpack_old(data)


def _unpack(data: bytes) -> State:
    saved = unpack(data, _NAME, {})
    level, buttons = saved.array("level", np.int64), saved.array("buttons", np.int8, low=0, high=1)
    if len(level) != 3 or len(buttons) != 4:
        raise SaveError(f"saved {_NAME}: a level is 3 numbers and there are 4 buttons")
    started = saved.number("started", high=1)
    return State(tuple(level.tolist()), tuple(map(bool, buttons)), bool(started))


def _unpack_old(data: bytes) -> State:
    record, checksum = data[: _OLD.size], data[_OLD.size :]
    if len(record) != _OLD.size or checksum != _OLD_CHECKSUM.pack(zlib.crc32(record)):
        raise SaveError(f"these {len(data)} bytes are not a whole save of {_NAME}")
    magic, seed, kind, difficulty, *buttons, started = _OLD.unpack(record)
    if magic != _OLD_MAGIC:
        raise SaveError(f"this is not a save of {_NAME}: it is marked {magic!r}")
    return State((seed, kind, difficulty), tuple(buttons), started)
