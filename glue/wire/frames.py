"""The head of a ZMTP frame: a byte of flags, and the size of the frame's content in one byte or eight.

Source: ZeroMQ RFC 23 (ZMTP 3.0), "Framing".
"""

from __future__ import annotations

import struct
from typing import Final

MORE: Final = 1
"""Flag of a frame that is not the last of its message."""

LONG: Final = 2
"""Flag of a frame whose size has eight bytes."""

COMMAND: Final = 4
"""Flag of a command."""

MAX_SHORT: Final = 255
"""Largest size that is written in one byte."""

SHORT_HEAD: Final = struct.Struct(">BB")
LONG_HEAD: Final = struct.Struct(">BQ")


def head(flags: int, size: int) -> bytes:
    """Return the head of a frame of `size` bytes; the flag `LONG` is set if it is needed."""
    return SHORT_HEAD.pack(flags, size) if size <= MAX_SHORT else LONG_HEAD.pack(flags | LONG, size)
