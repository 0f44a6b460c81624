"""The usual messages of a step, written and recognised as a whole, without a parser.

Nearly all messages of an experiment are ENV_STEP and AGENT_STEP, one call at a time, each of them complete
in what one system call receives. All of such a message but two scalars and the body is known before it
arrives, so that comparing bytes replaces parsing. Whatever differs, be it as legal as a number of another
width, is left to `zmtp.Decoder` and `wire.decode`, which check everything.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import Final

import msgpack

from glue.protocol.messages import CALLS, Body, Kind, Shape, Value
from glue.types import PREFIX_SIZE

__all__ = ["StepFormat", "step_formats"]

_FALSE: Final = 0xC2
_TRUE: Final = 0xC3
_FLOAT: Final = b"\xcb"
_MORE: Final = 1
_LONG: Final = 2

_REWARD: Final = struct.Struct(">d")
_REWARD_TERMINAL: Final = struct.Struct(">dB")
_SIZE: Final = struct.Struct(">Q")
_COUNTS: Final = struct.Struct("<4I")
_SHORT_HEADS: Final = [bytes((0, size)) for size in range(256)]
_MAX_SHORT: Final = 255

_pack_number: Final = msgpack.Packer(autoreset=True).pack


@lru_cache(maxsize=4096)
def step_formats(kind: Kind, session: str) -> tuple[StepFormat, StepFormat]:
    """Return the formats of the request and of the reply of ENV_STEP or AGENT_STEP in a session."""
    call = CALLS[kind]
    return StepFormat(kind, session, call.request), StepFormat(kind, session, call.reply)


class StepFormat:
    """The bytes of one kind of message of a step in one session, as a ZMTP message of two frames.

    Args:
        kind: ENV_STEP or AGENT_STEP.
        session: the session's name.
        shape: what it carries: no scalar, a reward, or a reward and a terminal; and an abstract type.

    Attributes:
        kind: as given.
    """

    __slots__ = ("_lead", "_scalars", "kind")

    def __init__(self, kind: Kind, session: str, shape: Shape) -> None:
        assert shape.body in (Body.OBSERVATION, Body.ACTION)
        self.kind = kind
        self._scalars = len(shape.scalars)
        self._lead = msgpack.packb((int(kind), session, 0, *([None] * self._scalars)))[: -1 - self._scalars]

    def _start(self, seq: int) -> bytes:
        """Return what is known of message `seq`: all up to its sequence number, and the type of a reward."""
        number = _pack_number(seq)
        scalars = self._scalars
        size = len(self._lead) + len(number) + (0, 9, 10)[scalars]
        start: bytes = bytes((_MORE, size)) + self._lead + number
        return start + _FLOAT if scalars else start

    def header(self, seq: int, scalars: tuple[Value, ...]) -> bytes:
        """Return the first frame of the message."""
        return self.encode(seq, scalars, b"")[2:-2]

    def encode(self, seq: int, scalars: tuple[Value, ...], body: bytes) -> bytes:
        """Return the message."""
        size = len(body)
        head = _SHORT_HEADS[size] if size <= _MAX_SHORT else b"\2" + _SIZE.pack(size)
        if not scalars:
            return self._start(seq) + head + body
        if len(scalars) == 1:
            return self._start(seq) + _REWARD.pack(scalars[0]) + head + body
        reward, terminal = scalars
        return self._start(seq) + _REWARD_TERMINAL.pack(reward, _TRUE if terminal else _FALSE) + head + body

    def decode(self, data: bytes, seq: int) -> tuple[tuple[Value, ...], bytes] | None:
        """Return the scalars and the body if `data` is exactly the message `seq` as `encode` writes it."""
        start = self._start(seq)
        if not data.startswith(start):
            return None
        at = len(start)
        scalars: tuple[Value, ...] = ()
        try:
            if self._scalars == 2:
                reward, terminal = _REWARD_TERMINAL.unpack_from(data, at)
                if terminal != _FALSE and terminal != _TRUE:
                    return None
                scalars = (reward, terminal == _TRUE)
                at += 9
            elif self._scalars:
                scalars = _REWARD.unpack_from(data, at)
                at += 8
            if data[at] == 0:
                size = data[at + 1]
                at += 2
            elif data[at] == _LONG:
                (size,) = _SIZE.unpack_from(data, at + 1)
                at += 9
            else:
                return None
            ints, doubles, chars, reserved = _COUNTS.unpack_from(data, at)
        except (struct.error, IndexError):
            return None
        if size != len(data) - at or size != PREFIX_SIZE + 8 * doubles + 4 * ints + chars or reserved:
            return None
        return scalars, data[at:]
