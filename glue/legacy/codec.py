"""The binary format of the original RL-Glue 3.x, without I/O: bytes in, messages out, and back.

    frame          int32 kind, uint32 payload size, payload
    payload        the scalars, then the body, that `glue.protocol.messages.CALLS` gives its kind;
                   but the scalars in reverse: terminal before reward
    terminal       int32; anything but zero means true
    reward, return float64
    steps, counts  int32; max_steps uint32
    text           uint32 byte count, bytes
    abstract type  uint32 number of ints I, of doubles D, of chars C,
                   then I int32, D float64 and C bytes; nothing in between

Everything is big-endian. On our side of the codec, scalars and bodies are those of our own protocol. Of an
abstract type only whole bytes are moved, so every bit of a NaN survives.

What the original server did with odd input, and what is done here:

- A payload longer than needed: the surplus is ignored, up to `SURPLUS` bytes.
- A payload shorter than needed: the original read on in old memory; here it is an error.
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
from collections.abc import Mapping
from enum import IntEnum
from typing import Final, NamedTuple

from glue.errors import LocalProtocolError, RemoteProtocolError
from glue.legacy.bodies import BODIES, MAX_STRING, too_short, until_zero
from glue.protocol.messages import CALLS, Body, Call, Kind, Role, Shape, Value

__all__ = [
    "FROM_AGENT",
    "FROM_ENVIRONMENT",
    "FROM_EXPERIMENT",
    "HANDSHAKE",
    "SURPLUS",
    "TO_AGENT",
    "TO_ENVIRONMENT",
    "TO_EXPERIMENT",
    "Control",
    "Decoder",
    "Frame",
    "Layout",
    "Vocabulary",
    "encode",
]

SURPLUS: Final = 65_536
"""Maximum number of bytes in a payload beyond the longest content of its kind."""

_HEADER: Final = struct.Struct(">iI")
_KINDS_OF_2: Final = frozenset((9, 15, 16, 17, 18, 28, 29, 30, 31, 32))


class Control(IntEnum):
    """The messages about the connection itself: a program's first, and the server's last."""

    CONNECT_EXPERIMENT = 1
    CONNECT_AGENT = 2
    CONNECT_ENVIRONMENT = 3
    TERMINATE = 35


class Frame(NamedTuple):
    """One message: its kind, scalars and body as in `protocol.messages.Message`, without a seed."""

    kind: Kind | Control
    scalars: tuple[Value, ...] = ()
    body: bytes = b""


class Layout(NamedTuple):
    """What the payload of one kind holds, and its maximum size in bytes."""

    kind: Kind | Control
    scalars: struct.Struct
    types: tuple[type, ...]
    body: Body
    limit: int


Vocabulary = Mapping[int, Layout]
"""The kinds of message that one side may send the other."""


class Decoder:
    """Decodes the messages of one direction of a connection, however the network split them.

    Args:
        vocabulary: the kinds that may be received; `expect` changes it once the role is known.

    After each `receive_data`, call `next_event` until it returns None. Then at most one incomplete message is
    held, whose size has been checked.
    """

    def __init__(self, vocabulary: Vocabulary) -> None:
        self._vocabulary = vocabulary
        self._buffer = bytearray()
        self._overhang = 0
        self._error: str | None = None

    def expect(self, vocabulary: Vocabulary) -> None:
        """Decode what is received from here on by `vocabulary`."""
        self._vocabulary = vocabulary

    @property
    def buffered(self) -> int:
        """Bytes received and not yet returned as a message."""
        return len(self._buffer)

    def receive_data(self, data: bytes) -> None:
        """Take bytes as they were received from the connection."""
        if self._error is None:
            self._buffer += data

    def next_event(self) -> Frame | None:
        """Return the next message, or None until more bytes are received.

        Raises:
            RemoteProtocolError: the bytes are not an expected message; every later call raises it again.
        """
        if self._error is not None:
            raise RemoteProtocolError(self._error)
        try:
            return self._next()
        except RemoteProtocolError as error:
            self._error = str(error)
            self._buffer.clear()
            raise

    def _next(self) -> Frame | None:
        buffer = self._buffer
        if self._overhang:
            self._take_overhang()
        if len(buffer) < _HEADER.size:
            return None
        kind, size = _HEADER.unpack_from(buffer)
        layout = self._vocabulary.get(kind)
        if layout is None:
            raise RemoteProtocolError(_unknown(kind, self._vocabulary))
        if size > layout.limit:
            raise RemoteProtocolError(
                f"a payload of at most {layout.limit} bytes was expected for {layout.kind.name}; "
                f"its header announces {size}"
            )
        end = _HEADER.size + size
        if len(buffer) < end:
            return None
        payload = bytes(buffer[_HEADER.size : end])
        del buffer[:end]
        try:
            scalars, offset = _read_scalars(layout, payload)
            body, offset = BODIES[layout.body].read(payload, offset)
        except RemoteProtocolError as error:
            raise RemoteProtocolError(f"{layout.kind.name}: {error}") from None
        if layout.body is Body.TEXT:
            body = until_zero(body if offset < size else self._with_overhang(body))
        return Frame(layout.kind, scalars, body)

    def _with_overhang(self, text: bytes) -> bytes:
        if text.isascii():
            return text
        # A UTF-16 unit takes at most three bytes of UTF-8, one of which has been counted.
        self._overhang = min(2 * len(text), MAX_STRING - len(text))
        return text + self._take_overhang()

    def _take_overhang(self) -> bytes:
        overhang = until_zero(bytes(self._buffer[: self._overhang]))
        del self._buffer[: len(overhang)]
        # A zero byte begins a frame: no more can hang over.
        self._overhang = 0 if self._buffer else self._overhang - len(overhang)
        return overhang


def encode(frame: Frame, vocabulary: Vocabulary) -> bytes:
    """Return the bytes of `frame`.

    Raises:
        LocalProtocolError: its kind is not in `vocabulary`, or a value does not fit the format or the
            limits of an original program.
    """
    kind, scalars, body = frame
    layout = vocabulary.get(kind)
    if layout is None:
        raise LocalProtocolError(_unknown(kind, vocabulary))
    try:
        payload = layout.scalars.pack(*reversed(scalars)) + BODIES[layout.body].write(body)
    except (struct.error, LocalProtocolError, RemoteProtocolError) as error:
        raise LocalProtocolError(f"{layout.kind.name} cannot be sent: {error}") from None
    return _HEADER.pack(kind, len(payload)) + payload


def _unknown(kind: int, vocabulary: Vocabulary) -> str:
    expected = ", ".join(f"{known} ({layout.kind.name})" for known, layout in vocabulary.items())
    hint = "; it belongs to RL-Glue 2.x, which is not supported" if kind in _KINDS_OF_2 else ""
    return f"expected a message of kind {expected}; received kind {int(kind)}{hint}"


def _read_scalars(layout: Layout, payload: bytes) -> tuple[tuple[Value, ...], int]:
    packer = layout.scalars
    if len(payload) < packer.size:
        raise too_short(packer.size, payload, 0)
    values = reversed(packer.unpack_from(payload))
    return tuple([of_type(value) for of_type, value in zip(layout.types, values, strict=True)]), packer.size


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
    packer = struct.Struct(">" + "".join(_SCALAR_FORMS[scalar.name] for scalar in reversed(scalars)))
    limit = packer.size + BODIES[shape.body].largest + SURPLUS
    return Layout(kind, packer, tuple(scalar.type for scalar in scalars), shape.body, limit)


def _controls(*kinds: Control) -> dict[int, Layout]:
    return {kind: _layout(kind, Shape()) for kind in kinds}


def _calls(callee: Role | None) -> dict[Kind, Call]:
    return {kind: call for kind, call in CALLS.items() if call.callee is callee and kind <= Kind.RL_AGENT_END}


def _requests(callee: Role | None) -> Vocabulary:
    return _controls(Control.TERMINATE) | {k: _layout(k, call.request) for k, call in _calls(callee).items()}


def _replies(callee: Role | None) -> Vocabulary:
    return _controls(Control.TERMINATE) | {k: _layout(k, call.reply) for k, call in _calls(callee).items()}


HANDSHAKE: Final = _controls(Control.CONNECT_EXPERIMENT, Control.CONNECT_AGENT, Control.CONNECT_ENVIRONMENT)
FROM_AGENT: Final = _replies(Role.AGENT)
FROM_ENVIRONMENT: Final = _replies(Role.ENVIRONMENT)
FROM_EXPERIMENT: Final = _requests(None)
TO_AGENT: Final = _requests(Role.AGENT)
TO_ENVIRONMENT: Final = _requests(Role.ENVIRONMENT)
TO_EXPERIMENT: Final = _replies(None)
