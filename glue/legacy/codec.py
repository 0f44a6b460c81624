"""The binary format of the original RL-Glue 3.x, without I/O: bytes in, messages out, and back.

    frame          int32 kind, uint32 payload size, payload
    payload        the scalars, then the body, as in `glue.wire.messages.CALLS` for its kind, except that
                   the scalars are in reverse order: terminal before reward
    terminal       int32; nonzero means true
    reward, return float64
    steps, counts  int32; max_steps uint32
    text           uint32 byte count, bytes
    abstract type  uint32 number of ints I, of doubles D, of chars C,
                   then I int32, D float64 and C bytes; nothing in between

Everything is big-endian. On our side of the codec, scalars and bodies are those of our own protocol. The
numbers of an abstract type are only byte-swapped, so every bit of a NaN survives.

Irregular input, in the original server and here:

- A payload longer than needed: the surplus is ignored, up to `SURPLUS` bytes.
- A payload shorter than needed: the original read stale memory; here it is an error.
- A zero byte in a text ends the text, in both directions, as in the original's C strings.
- More than a million ints, doubles or chars: the original server exited; here it is an error.
- The Java client counts a text in UTF-16 units, yet sends UTF-8. Beyond ASCII its count and the size of
  the frame are too small, and the end of the text follows the frame as an overhang. The first byte of a
  frame is always zero, that of an overhang hardly ever. So after a text that is not ASCII, everything up
  to the next zero byte is taken as the end of the text. If the network delivers the overhang separately,
  the text is delivered without its end, as the original always did, and the end is dropped on arrival.

Source: RL-Glue core 3.04, RL_network.c; rl-glue-ext, Java codec, Network.java.
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Mapping
from enum import IntEnum
from typing import Final, NamedTuple

from glue.errors import LocalProtocolError, RemoteProtocolError
from glue.legacy.bodies import BODIES, MAX_STRING, BodyForm, too_short, until_zero
from glue.wire.codec import FROM_HUB, TO_HUB
from glue.wire.messages import CALLS, THREE_ROLES, Body, Kind, Role, Shape, Value

SURPLUS: Final = 65_536
"""Maximum number of bytes in a payload beyond the longest content of its kind."""

_HEADER: Final = struct.Struct(">iI")

HEAD_SIZE: Final = _HEADER.size
"""Size in bytes of a frame's kind and size, which most original codecs send before the payload."""

_PIECE: Final = 4096
"""Size in bytes below which pieces are joined as they arrive: a small object has more overhead than data."""

_KINDS_OF_2: Final = frozenset((9, 15, 16, 17, 18, 28, 29, 30, 31, 32))


class Control(IntEnum):
    """The messages that open and end a connection: a program's first, and the server's last."""

    CONNECT_EXPERIMENT = 1
    CONNECT_AGENT = 2
    CONNECT_ENVIRONMENT = 3
    TERMINATE = 35


class Frame(NamedTuple):
    """One message: its kind, scalars and body as in `glue.wire.messages.Message`, without a seed."""

    kind: Kind | Control
    scalars: tuple[Value, ...] = ()
    body: bytes = b""


# Bound once: looking up a member of an enum takes longer than comparing with it.
_TEXT: Final = Body.TEXT

_frame: Final = tuple.__new__
"""Constructor of a named tuple, at half the cost of calling its class."""


class Layout(NamedTuple):
    """The frame of one kind.

    Attributes:
        kind: the kind.
        head: the kind, the size of the payload, and the scalars in reverse.
        types: the types of the scalars.
        terminal: whether the last scalar is a terminal.
        body: the content of the body.
        form: reads and writes the body.
        limit: maximum size of the payload, in bytes.
    """

    kind: Kind | Control
    head: struct.Struct
    types: tuple[type, ...]
    terminal: bool
    body: Body
    form: BodyForm
    limit: int


Vocabulary = Mapping[int, Layout]
"""The kinds of message that one side may send the other."""


class Decoder:
    """Decoder of the messages in one direction of a connection, however the network splits them.

    Args:
        vocabulary: the kinds that may be received; `expect` changes it once the role is known.
        max_body: maximum size of a body in our format, in bytes; by default, what `vocabulary` allows.

    After each `receive_data`, call `next_event` until it returns None. Then at most one incomplete message is
    held, whose size has been checked.

    Attributes:
        buffered: bytes received and not yet returned as a message.
        overhang: maximum number of bytes of the last text that may still follow.
    """

    def __init__(self, vocabulary: Vocabulary, max_body: int = sys.maxsize) -> None:
        self._vocabulary = vocabulary
        self._max_body = max_body
        self._buffer = b""
        self._at = 0  # offset of the first byte in it that is still needed
        self._later: list[bytes] = []  # received after the buffer, and not needed yet
        self._needed = HEAD_SIZE  # bytes of the next frame, as far as known
        self.buffered: int = 0
        self.overhang: int = 0
        self._error: str | None = None

    def expect(self, vocabulary: Vocabulary) -> None:
        """Decode further messages by `vocabulary`."""
        self._vocabulary = vocabulary

    def receive_data(self, data: bytes) -> None:
        """Add bytes received from the connection."""
        if self._error is not None:
            return
        if not self.buffered:
            self._buffer, self._at = data, 0
        elif self._later and len(self._later[-1]) < _PIECE:
            self._later[-1] += data
        else:
            self._later.append(data)
        self.buffered += len(data)

    def answer(self, data: bytes, kind: Kind | Control) -> tuple[tuple[Value, ...], bytes] | None:
        """Return scalars and body of a player's answer to `kind`, if `data` is all of it or all but its head.

        A step has a shorter way here. If the result is None, nothing has happened: `receive_data` takes it.
        """
        _, head, _, terminal, content, form, limit = self._vocabulary[kind]
        if self.buffered:
            if self.buffered != HEAD_SIZE:
                return None
            data = self._buffer[self._at :] + data
        size, at = len(data), head.size
        if size < at or size > limit or self.overhang or self._error is not None:
            return None
        values = head.unpack_from(data)
        if values[0] != kind or values[1] != size - HEAD_SIZE:
            return None
        theirs, body = form.latest
        if not data.startswith(theirs, at):
            if content is _TEXT:
                return None
            try:
                body, _ = form.read(data, at)
            except RemoteProtocolError:
                return None
        if len(body) > self._max_body:
            return None
        if self.buffered:
            self._buffer, self.buffered, self._needed = b"", 0, HEAD_SIZE
        return (values[3], values[2] != 0) if terminal else (), body

    def next_event(self) -> Frame | None:
        """Return the next message, or None until more bytes are received.

        Raises:
            RemoteProtocolError: the bytes are not an expected message; every later call raises it again.
        """
        if self._error is not None:
            raise RemoteProtocolError(self._error)
        if self.buffered < self._needed and not self.overhang:
            return None
        try:
            if self._later:
                self._buffer, self._at = b"".join((self._buffer[self._at :], *self._later)), 0
                self._later.clear()
            if self.overhang:
                self._take_overhang()
                if self.buffered < HEAD_SIZE:
                    return None
            kind, size = _HEADER.unpack_from(self._buffer, self._at)
            layout = self._vocabulary.get(kind)
            if layout is None:
                raise RemoteProtocolError(_unknown(kind, self._vocabulary))
            known, head, _, terminal, content, form, limit = layout
            if size > limit:
                raise RemoteProtocolError(
                    f"a payload of at most {limit} bytes was expected for {known.name}; "
                    f"its header announces {size}"
                )
            end = HEAD_SIZE + size
            if self.buffered < end:
                self._needed = end
                return None
            self._needed = HEAD_SIZE
            frame = self._take(end)
            if end < head.size:
                raise RemoteProtocolError(
                    f"{known.name}: {too_short(head.size - HEAD_SIZE, frame[HEAD_SIZE:], 0)}"
                )
            scalars = head.unpack_from(frame)[:1:-1]
            if terminal:
                scalars = (*scalars[:-1], scalars[-1] != 0)
            try:
                body, offset = form.read(frame, head.size)
            except RemoteProtocolError as error:
                raise RemoteProtocolError(f"{known.name}: {error}") from None
            if content is _TEXT:
                body = until_zero(body if offset < end else self._with_overhang(body))
            if len(body) > self._max_body:
                raise RemoteProtocolError(
                    f"{known.name} has a body of {len(body)} bytes; this hub takes {self._max_body}"
                )
        except RemoteProtocolError as error:
            self._error = str(error)
            self._buffer, self._at, self.buffered = b"", 0, 0
            self._later.clear()
            raise
        return _frame(Frame, (known, scalars, body))

    def _take(self, size: int) -> bytes:
        """Return the next bytes, and drop them from the buffer."""
        start, end = self._at, self._at + size
        taken = self._buffer[start:end]
        self.buffered -= size
        if 2 * end >= len(self._buffer):
            self._buffer, self._at = self._buffer[end:], 0
        else:
            self._at = end
        return taken

    def _with_overhang(self, text: bytes) -> bytes:
        if text.isascii():
            return text
        # A UTF-16 unit takes at most three bytes of UTF-8, one of which has been counted.
        self.overhang = min(2 * len(text), MAX_STRING - len(text))
        return text + self._take_overhang()

    def _take_overhang(self) -> bytes:
        overhang = until_zero(self._buffer[self._at : self._at + self.overhang])
        self._take(len(overhang))
        # If bytes are left, a frame begins here: the overhang is complete.
        self.overhang = 0 if self.buffered else self.overhang - len(overhang)
        return overhang


def encode(frame: Frame | tuple[Kind, tuple[Value, ...], bytes], vocabulary: Vocabulary) -> bytes:
    """Return the bytes of `frame`; a plain tuple of its parts takes less time to make.

    Raises:
        LocalProtocolError: its kind is not in `vocabulary`, or a value does not fit the format or the
            limits of an original program.
    """
    kind, scalars, body = frame
    layout = vocabulary.get(kind)
    if layout is None:
        raise LocalProtocolError(_unknown(kind, vocabulary))
    try:
        head, form = layout.head, layout.form
        theirs, ours = form.latest
        written = theirs if body == ours else form.write(body)
        return head.pack(kind, head.size - HEAD_SIZE + len(written), *scalars[::-1]) + written
    except (struct.error, LocalProtocolError, RemoteProtocolError) as error:
        raise LocalProtocolError(f"{layout.kind.name} cannot be sent: {error}") from None


def _unknown(kind: int, vocabulary: Vocabulary) -> str:
    expected = ", ".join(f"{known} ({layout.kind.name})" for known, layout in vocabulary.items())
    hint = "; it belongs to RL-Glue 2.x, which is not supported" if kind in _KINDS_OF_2 else ""
    return f"expected a message of kind {expected}; received kind {int(kind)}{hint}"


_SCALAR_FORMS: Final = {
    "reward": "d",
    "terminal": "i",
    "max_steps": "I",
    "return": "d",
    "num_steps": "i",
    "num_episodes": "i",
}


def _layout(kind: Kind | Control, shape: Shape) -> Layout:
    scalars = [scalar for scalar in shape.scalars if not scalar.optional]
    head = struct.Struct(">iI" + "".join(_SCALAR_FORMS[scalar.name] for scalar in reversed(scalars)))
    form = BODIES[shape.body]
    limit = head.size - HEAD_SIZE + form.largest + SURPLUS
    types = tuple(scalar.type for scalar in scalars)
    return Layout(kind, head, types, bool in types, shape.body, form, limit)


def _controls(*kinds: Control) -> dict[int, Layout]:
    return {kind: _layout(kind, Shape()) for kind in kinds}


def _vocabulary(role: Role, shapes: Mapping[Kind, Shape]) -> Vocabulary:
    callee = None if role is Role.EXPERIMENT else role
    kinds = [kind for kind in CALLS if CALLS[kind].callee is callee and kind <= Kind.RL_AGENT_END]
    return _controls(Control.TERMINATE) | {kind: _layout(kind, shapes[kind]) for kind in kinds}


HANDSHAKE: Final = _controls(Control.CONNECT_EXPERIMENT, Control.CONNECT_AGENT, Control.CONNECT_ENVIRONMENT)
FROM: Final = {role: _vocabulary(role, TO_HUB) for role in THREE_ROLES}
TO: Final = {role: _vocabulary(role, FROM_HUB) for role in THREE_ROLES}
