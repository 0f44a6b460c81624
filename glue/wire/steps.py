"""The usual messages of a step, written and recognised as a whole, without a parser; for `glue.wire.stream`.

Nearly all messages of an experiment are ENV_STEP and AGENT_STEP, one call at a time, each of them complete
in what one system call receives. All of such a message but three numbers and the body is known before it
arrives, so that one comparison replaces parsing. Whatever differs, be it as legal as a scalar of another
type, is left to `zmtp.Decoder` and `codec.decode`, which check everything.
"""

from __future__ import annotations

import struct
from functools import lru_cache
from typing import Final, NamedTuple

import msgpack

from glue.types import CUT_OFF, PREFIX_SIZE
from glue.wire.messages import CALLS, Body, Kind, Message, Shape, Value

STEPS: Final = frozenset({Kind.ENV_STEP, Kind.AGENT_STEP})
"""The calls of a step."""

_MAX_FIXED_TEXT: Final = 31
"""Bytes of the longest text of which msgpack writes the length into its first byte."""

_FALSE: Final = 0xC2
_TRUE: Final = 0xC3
_TERMINALS: Final[dict[int, Value]] = {_FALSE: False, _TRUE: True, CUT_OFF: CUT_OFF}
_FLOAT: Final = 0xCB
_MORE: Final = 1
_LONG: Final = 2
_MAX_SHORT: Final = 255
_HEAD: Final = 2
"""Bytes of the flags and the length of the header's frame: with a session of 31 bytes it is a short one."""

_NO_SCALARS: Final[tuple[Value, ...]] = ()

_COUNTS: Final = struct.Struct("<4I")
_SCALARS: Final = ("", "Bd", "BdB")
"""A reward is its type and eight bytes, a terminal is one byte."""

_MAX_FIXED: Final = 7
_NUMBERS: Final = ((_MAX_FIXED, b"", "B"), (8, b"\xcc", "B"), (16, b"\xcd", "H"), (32, b"\xce", "I"))
"""msgpack's whole numbers: the bits that each form has room for, its first byte, and what follows."""

_FORM_OF_BITS: Final = [next(i for i, form in enumerate(_NUMBERS) if bits <= form[0]) for bits in range(33)]
_FORM_OF_FIRST: Final = {
    byte: i for i, (_, first, _) in enumerate(_NUMBERS) for byte in first or range(2**_MAX_FIXED)
}
"""The form of a number by the count of its bits, and the form that a first byte begins."""


class _Layout(NamedTuple):
    """All that comes before the body, with one form of the sequence number.

    `start` is what comes before that number; `short` and `long` pack it, the number, the scalars, and the
    head of the body's frame, which begins at `head`.
    """

    start: bytes
    short: struct.Struct
    long: struct.Struct
    head: int


_struct: Final = lru_cache(struct.Struct)
"""One for all sessions: many sessions are as fast as their formats fit into the processor's caches."""


@lru_cache(maxsize=4096)
def step_formats(kind: Kind, session: str) -> tuple[StepFormat, StepFormat] | None:
    """Return the formats of the request and the reply of ENV_STEP or AGENT_STEP in a session.

    There are none for a session whose name has more than 31 bytes, as hardly any has.
    """
    if len(session.encode()) > _MAX_FIXED_TEXT:
        return None
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
        session: as given.
        lead: the bytes from the first frame's beginning to its sequence number, as `lead_of` finds them.
        max_seq: the largest sequence number that it has a form for, 2**32 - 1.
    """

    __slots__ = ("_layouts", "_number_at", "_scalars", "kind", "lead", "session")

    max_seq: Final = 2**32 - 1

    def __init__(self, kind: Kind, session: str, shape: Shape) -> None:
        assert shape.body in (Body.OBSERVATION, Body.ACTION)
        self.kind: Kind = kind
        self.session: str = session
        self._scalars = len(shape.scalars)
        self.lead: bytes = msgpack.packb((int(kind), session, 0, *([None] * self._scalars)))[
            : -1 - self._scalars
        ]
        self._number_at = _HEAD + len(self.lead)
        self._layouts = tuple(self._layout(first, letter) for _, first, letter in _NUMBERS)

    def _layout(self, first: bytes, letter: str) -> _Layout:
        """Return the layout with a sequence number that begins with `first` and goes on as `letter` says."""
        numbers = letter + _SCALARS[self._scalars]
        size = len(self.lead) + len(first) + struct.calcsize(">" + numbers)
        start = bytes((_MORE, size)) + self.lead + first
        short, long = (_struct(f">{len(start)}s{numbers}{frame}") for frame in ("BB", "BQ"))
        return _Layout(start, short, long, _HEAD + size)

    def head(self, seq: int, scalars: tuple[Value, ...], size: int) -> bytes:
        """Return the bytes before a body of `size` bytes; `seq` is at most `max_seq`."""
        start, short, long, _ = self._layouts[_FORM_OF_BITS[seq.bit_length()]]
        pack, flags = (short.pack, 0) if size <= _MAX_SHORT else (long.pack, _LONG)
        if not scalars:
            return pack(start, seq, flags, size)
        if len(scalars) == 1:
            return pack(start, seq, _FLOAT, scalars[0], flags, size)
        reward, terminal = scalars
        flag = _FALSE if not terminal else CUT_OFF if terminal == CUT_OFF else _TRUE
        return pack(start, seq, _FLOAT, reward, flag, flags, size)

    def decode(self, data: bytes, at: int, max_body: int) -> tuple[Message, int] | None:
        """Return the message that begins at `at`, and where it ends; None unless it has this format.

        None, too, unless all of it is there, and its body has at most `max_body` bytes.
        """
        scalars = _NO_SCALARS
        try:
            layout = self._layouts[_FORM_OF_FIRST[data[at + self._number_at]]]
            expected, short, long, head = layout
            form = long if data[at + head] else short
            body_at = at + form.size
            if not self._scalars:
                start, seq, flags, size = form.unpack_from(data, at)
            elif self._scalars == 1:
                start, seq, type_, reward, flags, size = form.unpack_from(data, at)
                if type_ != _FLOAT:
                    return None
                scalars = (reward,)
            else:
                start, seq, type_, reward, terminal, flags, size = form.unpack_from(data, at)
                if type_ != _FLOAT or terminal not in _TERMINALS:
                    return None
                scalars = (reward, _TERMINALS[terminal])
            ints, doubles, chars, reserved = _COUNTS.unpack_from(data, body_at)
        except (struct.error, LookupError):
            return None
        end = body_at + size
        if (
            start != expected
            or end > len(data)
            or (flags and flags != _LONG)
            or size > max_body
            or size != PREFIX_SIZE + 8 * doubles + 4 * ints + chars
            or reserved
        ):
            return None
        return _message(Message, (self.kind, self.session, seq, scalars, data[body_at:end])), end


_message: Final = tuple.__new__
"""Makes a named tuple at half the cost of calling its class."""


def lead_of(data: bytes, at: int) -> bytes:
    """Return the `lead` of the format of the message that begins at `at`, if it has a format."""
    name = data[at + 4 : at + 5]
    return data[at + 2 : at + 5 + (name[0] & _MAX_FIXED_TEXT)] if name else b""
