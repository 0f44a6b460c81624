"""ZMTP 3, the protocol between ZeroMQ's sockets, without I/O: both ends of a DEALER's connection to a ROUTER.

Bytes go in, messages come out, and bytes to answer at once:

    decoder = Decoder(ROUTER, max_frame=2**20)
    decoder.receive_data(data)
    while (event := decoder.next_event()) is not None:
        ...

Only the mechanism NULL is spoken. Commands that are not understood are ignored, as the standard requires.
Sizes are checked before anything of that size is kept; frames beyond those that a caller wants to see are not
kept.

Source: ZeroMQ RFC 23 (ZMTP 3.0) and RFC 37 (ZMTP 3.1).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Final

from glue.errors import RemoteProtocolError

__all__ = ["DEALER", "GREETING", "ROUTER", "Decoder", "encode"]

DEALER: Final = b"DEALER"
ROUTER: Final = b"ROUTER"

GREETING: Final = b"\xff" + bytes(8) + b"\x7f" + b"\x03\x01" + b"NULL".ljust(20, b"\0") + bytes(32)
"""What either side says first: a signature, version 3.1, the mechanism, and that this is no matter of server
and client."""

_MORE: Final = 1
_LONG: Final = 2
_COMMAND: Final = 4
_KNOWN_FLAGS: Final = _MORE | _LONG | _COMMAND

_MAX_COMMAND: Final = 4096
"""The largest command, in bytes: room for any READY."""

_KEPT: Final = 3
"""Frames of a message that are kept: one more than any message of ours has shows that it is too long."""

_AT_ONCE: Final = 16
"""Frames after which the caller may serve another connection, even if no message is complete."""

_PIECE: Final = 4096
"""Bytes below which what comes is put together at once: a little piece takes more room than it holds."""

_SIZE: Final = struct.Struct(">Q")
_SHORT_HEADS: Final = [[bytes((flags, size)) for size in range(256)] for flags in (0, _MORE)]


def encode(frames: Sequence[bytes]) -> bytes:
    """Return the bytes of a message of at least one frame."""
    parts = []
    more = len(frames) - 1
    for frame in frames:
        size = len(frame)
        flags = _MORE if more else 0
        if size < 256:
            parts.append(_SHORT_HEADS[flags][size])
        else:
            parts.append(bytes((flags | _LONG,)) + _SIZE.pack(size))
        parts.append(frame)
        more -= 1
    return b"".join(parts)


def _command(name: bytes, data: bytes) -> bytes:
    body = bytes((len(name),)) + name + data
    return bytes((_COMMAND, len(body))) + body


def _property(name: bytes, value: bytes) -> bytes:
    return bytes((len(name),)) + name + struct.pack(">I", len(value)) + value


_READY: Final = {own: _command(b"READY", _property(b"Socket-Type", own)) for own in (DEALER, ROUTER)}
_PARTNER: Final = {DEALER: ROUTER, ROUTER: DEALER}


class Decoder:
    """What one connection says, from its first byte on.

    Args:
        own: this end of the connection, ROUTER or DEALER; the other end has to be its partner.
        max_frame: the largest frame that is accepted, in bytes.

    Attributes:
        ready: the handshake is complete.
    """

    def __init__(self, own: bytes, max_frame: int) -> None:
        self._own = own
        self._max_frame = max_frame
        self._buffer = b""
        self._at = 0  # what comes before it is done with
        self._later: list[bytes] = []  # what was received after it, until it is needed
        self._size = 0  # bytes of both that are not done with
        self._needed = len(GREETING)  # bytes without which there is nothing to do
        self._frames: list[bytes] = []  # of a message that is not complete
        self._greeted = False
        self.ready = False

    @property
    def between_messages(self) -> bool:
        """Whether the next byte begins a message: nothing is kept, and nothing of the handshake is left."""
        return self.ready and not self._size and not self._frames

    @property
    def buffered(self) -> int:
        """Bytes that are kept, waiting for more or for `next_event`."""
        return self._size + sum(map(len, self._frames))

    def receive_data(self, data: bytes) -> None:
        """Take bytes that were received."""
        if not self._size:
            self._buffer = data
            self._at = 0
        elif self._later and len(self._later[-1]) < _PIECE:
            self._later[-1] += data
        else:
            self._later.append(data)
        self._size += len(data)

    def next_event(self) -> list[bytes] | bytes | None:
        """Return the frames of a message, or bytes that are to be sent at once; None if more must come.

        There may be no bytes to be sent: what has come so far asks for nothing, but there is more of it.
        Of a message of more than two frames, three are returned.

        Raises:
            RemoteProtocolError: this is not ZMTP 3, not what a DEALER says, or too large.
        """
        for _ in range(_AT_ONCE):
            if self._size < self._needed:
                return None
            if self._later:
                self._buffer = b"".join((self._buffer[self._at :], *self._later))
                self._at = 0
                self._later.clear()
            if not self._greeted:
                self._check_greeting(self._take(0, len(GREETING)))
                self._greeted = True
                self._needed = 2
                return _READY[self._own]
            flags, size = self._buffer[self._at], self._buffer[self._at + 1]
            head = 2
            if flags & _LONG:
                head = 9
                if self._size < head:
                    self._needed = head
                    return None
                (size,) = _SIZE.unpack_from(self._buffer, self._at + 1)
            if self._needed <= head:
                self._check_head(flags, size)
            if self._size < head + size:
                self._needed = head + size
                return None
            self._needed = 2
            frame = self._take(head, size)
            if flags & _COMMAND:
                answer = self._obey(frame)
                if answer:
                    return answer
                continue
            frames = self._frames
            if len(frames) < _KEPT:
                frames.append(frame)
            if not flags & _MORE:
                self._frames = []
                return frames
        return b""

    def _take(self, skipped: int, size: int) -> bytes:
        """Return the next bytes, after some that are skipped."""
        start = self._at + skipped
        self._at = end = start + size
        self._size -= skipped + size
        taken = self._buffer[start:end]
        if 2 * end >= len(self._buffer):
            # What is done with may be large, and should not stay.
            self._buffer = self._buffer[end:]
            self._at = 0
        return taken

    def _check_greeting(self, greeting: bytes) -> None:
        if greeting[0] != 0xFF or not greeting[9] & 1:
            raise RemoteProtocolError("it does not speak ZeroMQ's protocol")
        if greeting[10] < 3:
            raise RemoteProtocolError("it speaks a ZMTP before 3: use a ZeroMQ library from 4.0 on")
        mechanism = greeting[12:32].rstrip(b"\0")
        if mechanism != b"NULL":
            raise RemoteProtocolError(
                f"it wants the security mechanism {mechanism!r}; only NULL is spoken here"
            )

    def _check_head(self, flags: int, size: int) -> None:
        if flags & ~_KNOWN_FLAGS or (flags & _COMMAND and flags & _MORE):
            raise RemoteProtocolError(f"a frame cannot have the flags {flags}")
        if not self.ready and not flags & _COMMAND:
            raise RemoteProtocolError("a message was received before READY")
        limit = _MAX_COMMAND if flags & _COMMAND else self._max_frame
        if size > limit:
            raise RemoteProtocolError(f"a frame of {size} bytes was received; {limit} are allowed")

    def _obey(self, command: bytes) -> bytes:
        """Act on a command; return what is to be said to it, if anything."""
        end = command[0] + 1 if command else 0
        name, data = command[1:end], command[end:]
        if name == b"PING":
            # Two bytes of time to live, which is the sender's own business, and a context to give back.
            return _command(b"PONG", data[2:18])
        if name == b"READY":
            self._check_socket(data)
            self.ready = True
        elif name == b"ERROR":
            raise RemoteProtocolError(f"it ended the handshake: {data[1:]!r:.80}")
        return b""

    def _check_socket(self, properties: bytes) -> None:
        at = 0
        try:
            while at < len(properties):
                value_at = at + 1 + properties[at]
                (size,) = struct.unpack_from(">I", properties, value_at)
                name, value = properties[at + 1 : value_at], properties[value_at + 4 : value_at + 4 + size]
                at = value_at + 4 + size
                if name.lower() == b"socket-type":
                    if value != _PARTNER[self._own]:
                        raise RemoteProtocolError(
                            f"it is a socket of type {value!r:.20}, not {_PARTNER[self._own].decode()}"
                        )
                    return
        except struct.error:
            pass
        raise RemoteProtocolError("its READY does not say what socket it is")
