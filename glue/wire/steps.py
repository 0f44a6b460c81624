"""The usual messages of a step, written and recognised as a whole, without a parser; for `glue.wire.stream`.

Nearly all messages of an experiment are ENV_STEP and AGENT_STEP, one call at a time, each received completely
by one system call. Except for three numbers and the body, such a message is known before it arrives, so that
one comparison replaces parsing. A message that differs, even legally, as by a scalar of another type, is left
to `zmtp.Decoder` and `codec.decode`, which check everything.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from functools import lru_cache
from typing import Any, Final, NamedTuple

import msgpack

from glue.types import CUT_OFF, PREFIX_SIZE, body_size, has_beside
from glue.wire.messages import CALLS, Body, Kind, Message, Shape, Value
from glue.wire.zmtp import LONG, MAX_SHORT, MORE, SHORT_HEAD

STEPS: Final = frozenset({Kind.ENV_STEP, Kind.AGENT_STEP})
"""The calls of a step."""

_MAX_FIXED_TEXT: Final = 31
"""Maximum size in bytes of a text whose length msgpack writes into the first byte."""

_FALSE: Final = 0xC2
_TRUE: Final = 0xC3
_TERMINALS: Final[dict[int, Value]] = {_FALSE: False, _TRUE: True, CUT_OFF: CUT_OFF}
_FLOAT: Final = 0xCB
_HEAD: Final = SHORT_HEAD.size
"""Size of the head of the header's frame, which is short even with a session of 31 bytes."""

_NO_SCALARS: Final[tuple[Value, ...]] = ()
_NOTHING: Final = struct.Struct("")
"""Format that unpacks nothing, so that the first message fits no shape."""

_COUNTS: Final = struct.Struct("<3I2H")
_SCALARS: Final = ("", "Bd", "BdB")
"""Formats of 0, 1 and 2 scalars: a reward is a type and eight bytes, a terminal is one byte."""

_MAX_FIXED: Final = 7
_NUMBERS: Final = ((_MAX_FIXED, b"", "B"), (8, b"\xcc", "B"), (16, b"\xcd", "H"), (32, b"\xce", "I"))
"""Forms of msgpack's whole numbers: bits of the largest number, first byte, and format of the rest."""

_FORM_OF_BITS: Final = [next(i for i, form in enumerate(_NUMBERS) if bits <= form[0]) for bits in range(33)]
_FORM_OF_FIRST: Final = {
    byte: i for i, (_, first, _) in enumerate(_NUMBERS) for byte in first or range(2**_MAX_FIXED)
}
"""Index in `_NUMBERS` of the form of a number: by its count of bits, and by its first byte."""


class _Layout(NamedTuple):
    """The bytes before the body, for one form of the sequence number.

    `start` holds the bytes before that number, and `numbers` is the format of the number and the scalars;
    `short` and `long` pack all of these and the head of the body's frame, which begins at `head`.
    """

    start: bytes
    numbers: str
    short: struct.Struct
    long: struct.Struct
    head: int


_struct: Final = lru_cache(struct.Struct)
"""Shared by all sessions: many sessions are fast only if their formats fit into the processor's caches."""


def step_formats(kind: Kind, session: str) -> tuple[StepFormat, StepFormat] | None:
    """Return the formats of the request and the reply of ENV_STEP or AGENT_STEP in a session.

    Return None for a session whose name has more than 31 bytes, which is rare.
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
        shape: its contents: no scalar, a reward, or a reward and a terminal; and an abstract type.

    Attributes:
        kind: as given.
        session: as given.
        lead: the bytes of the first frame before its sequence number, as `lead_of` finds them.
        is_action: whether the abstract type is an action.
        num_scalars: number of scalars.
        number_at: offset of the sequence number in the message.
        max_seq: the largest sequence number that it can encode, 2**32 - 1.
    """

    __slots__ = ("_layouts", "is_action", "kind", "lead", "num_scalars", "number_at", "session")

    max_seq: Final = 2**32 - 1

    def __init__(self, kind: Kind, session: str, shape: Shape) -> None:
        assert shape.body in (Body.OBSERVATION, Body.ACTION)
        self.kind: Kind = kind
        self.session: str = session
        self.is_action: bool = shape.body is Body.ACTION
        self.num_scalars: int = len(shape.scalars)
        self.lead: bytes = msgpack.packb((int(kind), session, 0, *([None] * self.num_scalars)))[
            : -1 - self.num_scalars
        ]
        self.number_at: int = _HEAD + len(self.lead)
        self._layouts = tuple(self._layout(first, letter) for _, first, letter in _NUMBERS)

    def _layout(self, first: bytes, letter: str) -> _Layout:
        """Return the layout for a sequence number that consists of `first` and the format `letter`."""
        numbers = letter + _SCALARS[self.num_scalars]
        size = len(self.lead) + len(first) + struct.calcsize(">" + numbers)
        start = bytes((MORE, size)) + self.lead + first
        short, long = (_struct(f">{len(start)}s{numbers}{frame}") for frame in ("BB", "BQ"))
        return _Layout(start, numbers, short, long, _HEAD + size)

    def head(self, seq: int, scalars: tuple[Value, ...], size: int) -> bytes:
        """Return the bytes before a body of `size` bytes; `seq` is at most `max_seq`."""
        start, _, short, long, _ = self._layouts[_FORM_OF_BITS[seq.bit_length()]]
        pack, flags = (short.pack, 0) if size <= MAX_SHORT else (long.pack, LONG)
        if not scalars:
            return pack(start, seq, flags, size)
        if len(scalars) == 1:
            return pack(start, seq, _FLOAT, scalars[0], flags, size)
        reward, terminal = scalars
        flag = _FALSE if not terminal else CUT_OFF if terminal == CUT_OFF else _TRUE
        return pack(start, seq, _FLOAT, reward, flag, flags, size)

    def layout_of(self, data: bytes, at: int) -> _Layout:
        """Return the layout of a message that begins at `at`, by the first byte of its sequence number.

        Raises:
            LookupError: the bytes end before that byte, or no whole number begins with it.
        """
        return self._layouts[_FORM_OF_FIRST[data[at + self.number_at]]]


class StepReader:
    """Recognises the messages of one format, and remembers the shape of one of them.

    Most messages differ from an earlier one only in their number, their scalars and the elements of their
    body. Two comparisons of bytes then replace all other checks. A reader is used either with `read`, for the
    bytes of ZMTP, or with `read_frames` and `learn`, for decrypted frames.

    Args:
        form: the format.

    Attributes:
        end: offset of the end of the last message read.
    """

    __slots__ = (
        "_body_at",
        "_form",
        "_kind",
        "_num_scalars",
        "_session",
        "_size",
        "_start",
        "_tail",
        "_unpack",
        "end",
    )

    def __init__(self, form: StepFormat) -> None:
        self.end: int = 0
        self._form = form
        self._kind = form.kind
        self._session = form.session
        self._num_scalars = form.num_scalars
        self._unpack: Callable[..., tuple[Any, ...]] = _NOTHING.unpack_from
        self._start = b""  # the bytes before the number
        self._tail = b""  # the bytes between the scalars and the elements of the body
        self._body_at = 0
        self._size = 0

    def read(self, data: bytes, at: int, max_body: int) -> Message | None:
        """Return the message that begins at `at`.

        Return None if it has another format, is incomplete, or has a body of more than `max_body` bytes.
        """
        try:
            if not self._num_scalars:
                start, seq, tail = self._unpack(data, at)
                type_, scalars = _FLOAT, _NO_SCALARS
            elif self._num_scalars == 1:
                start, seq, type_, reward, tail = self._unpack(data, at)
                scalars = (reward,)
            else:
                start, seq, type_, reward, terminal, tail = self._unpack(data, at)
                scalars = (reward, _TERMINALS[terminal])
        except (struct.error, ValueError, LookupError):
            return self._read_another(data, at, max_body)
        begin, end = at + self._body_at, at + self._size
        if (
            start != self._start
            or tail != self._tail
            or type_ != _FLOAT
            or end > len(data)
            or end - begin > max_body
        ):
            return self._read_another(data, at, max_body)
        self.end = end
        return _message(Message, (self._kind, self._session, seq, scalars, data[begin:end]))

    def _read_another(self, data: bytes, at: int, max_body: int) -> Message | None:
        """Return a message of any shape, like `read`, and remember its shape if it can be compared."""
        try:
            layout = self._form.layout_of(data, at)
            head = layout.long if data[at + layout.head] else layout.short
            start, seq, *scalars, flags, size = head.unpack_from(data, at)
            body_at = at + head.size
            ints, doubles, chars, mask, extras = _COUNTS.unpack_from(data, body_at)
            types, scalars = scalars[:1], scalars[1:]
            if self._num_scalars == 2:
                scalars[1] = _TERMINALS[scalars[1]]
        except (struct.error, LookupError):
            return None
        end = body_at + size
        if (
            start != layout.start
            or types not in ([], [_FLOAT])
            or end > len(data)
            or (flags and flags != LONG)
            or size > max_body
            or size != PREFIX_SIZE + 8 * doubles + 4 * ints + chars + mask + extras
            or (self._form.is_action and (mask or extras))
        ):
            return None
        self.end = end
        # A number of a single byte has no fixed first byte to compare.
        if len(start) > self._form.number_at:
            self._start = start
            self._tail = data[at + layout.head : body_at + PREFIX_SIZE]
            self._unpack = _struct(f">{len(start)}s{layout.numbers}{len(self._tail)}s").unpack_from
            self._body_at = head.size
            self._size = end - at
        return Message(self._kind, self._session, seq, tuple(scalars), data[body_at:end])

    def read_frames(self, header: bytes, body: bytes, max_body: int) -> Message | None:
        """Return the message in two frames, if its header is like the one learned, and its body valid."""
        try:
            if not self._num_scalars:
                start, seq = self._unpack(header)
                type_, scalars = _FLOAT, _NO_SCALARS
            elif self._num_scalars == 1:
                start, seq, type_, reward = self._unpack(header)
                scalars = (reward,)
            else:
                start, seq, type_, reward, terminal = self._unpack(header)
                scalars = (reward, _TERMINALS[terminal])
        except (struct.error, ValueError, LookupError):
            return None
        size = len(body)
        if start != self._start or type_ != _FLOAT or size > max_body:
            return None
        if size != self._size or not body.startswith(self._tail):
            if size < PREFIX_SIZE or body_size(body) != size or (self._form.is_action and has_beside(body)):
                return None
            self._size, self._tail = size, body[:PREFIX_SIZE]
        return _message(Message, (self._kind, self._session, seq, scalars, body))

    def learn(self, message: Message, header: bytes) -> None:
        """Remember the header of a decoded message for `read_frames`, if it is in this format."""
        form, (kind, _, seq, scalars, body) = self._form, message
        # A number of a single byte has no fixed first byte to compare.
        if (
            kind is self._kind
            and len(scalars) == form.num_scalars  # more, if the agent is told its time
            and 2**_MAX_FIXED <= seq <= form.max_seq
            and form.head(seq, scalars, 0)[_HEAD:-_HEAD] == header
        ):
            layout = form.layout_of(header, -_HEAD)
            self._start = layout.start[_HEAD:]
            self._unpack = _struct(f">{len(self._start)}s{layout.numbers}").unpack
            self._size, self._tail = len(body), body[:PREFIX_SIZE]


_message: Final = tuple.__new__
"""Constructor of a named tuple, at half the cost of calling its class."""


def lead_of(data: bytes, at: int) -> bytes:
    """Return the `lead` of the format of the message that begins at `at`, if it has a format."""
    name = data[at + 4 : at + 5]
    return data[at + 2 : at + 5 + (name[0] & _MAX_FIXED_TEXT)] if name else b""
