"""ZMTP 3, the protocol between ZeroMQ's sockets, without I/O: both ends of a DEALER's connection to a ROUTER.

Bytes go in; messages come out, and bytes to send at once:

    decoder = Decoder(ROUTER, max_frame=2**20)
    decoder.receive_data(data)
    while (event := decoder.next_event()) is not None:
        ...

The mechanism is NULL, or CURVE if one of its ends is given (see `glue.wire.curve`). Unknown commands are
ignored, as the standard requires. Sizes are checked before data of that size is kept; frames beyond those
that a caller needs are discarded.

Source: ZeroMQ RFC 23 (ZMTP 3.0) and RFC 37 (ZMTP 3.1).
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Final, Protocol

from glue.errors import RemoteProtocolError

DEALER: Final = b"DEALER"
ROUTER: Final = b"ROUTER"

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


def _greeting(mechanism: bytes, as_server: int) -> bytes:
    return b"\xff" + bytes(8) + b"\x7f\x03\x01" + mechanism.ljust(20, b"\0") + bytes((as_server,)) + bytes(31)


GREETING: Final = _greeting(b"NULL", 0)
"""The first bytes of either side: a signature, version 3.1, the mechanism, and the role of a client, which
means nothing with this mechanism."""

CURVE_GREETING: Final = _greeting(b"CURVE", 1)
"""The server's greeting with CURVE."""

CURVE_CLIENT_GREETING: Final = _greeting(b"CURVE", 0)
"""The client's greeting with CURVE."""

_KNOWN_FLAGS: Final = MORE | LONG | COMMAND

_ENCRYPTED_COMMAND: Final = 2
"""The flag of a command inside an encrypted frame."""

_MAX_COMMAND: Final = 4096
"""Maximum size of a command, in bytes: room for any READY."""

_KEPT: Final = 3
"""Maximum number of frames kept of a message: one more than our longest has, to show that it is too long."""

_AT_ONCE: Final = 16
"""Number of frames after which the caller may serve another connection, even without a complete message."""


def encode(frames: Sequence[bytes]) -> bytes:
    """Return the bytes of a message of at least one frame."""
    return b"".join(encode_parts(frames))


def encode_parts(frames: Sequence[bytes]) -> tuple[bytes, bytes]:
    """Return the bytes of a message in two parts; the second is the content of its last frame."""
    *others, last = frames
    parts = [part for frame in others for part in (head(MORE, len(frame)), frame)]
    return b"".join((*parts, head(0, len(last)))), last


def _command(body: bytes) -> bytes:
    """Return the frame of a command; b"" if its body is empty."""
    return head(COMMAND, len(body)) + body if body else b""


def _name(name: bytes) -> bytes:
    return bytes((len(name),)) + name


_METADATA: Final = {
    own: _name(b"Socket-Type") + struct.pack(">I", len(own)) + own for own in (DEALER, ROUTER)
}
_READY: Final = {own: _command(_name(b"READY") + metadata) for own, metadata in _METADATA.items()}
_PARTNER: Final = {DEALER: ROUTER, ROUTER: DEALER}


class OtherMechanism(RemoteProtocolError):
    """The other side speaks ZMTP 3, but with another security mechanism."""


class HandshakeEnded(RemoteProtocolError):
    """The other side has ended the handshake with ERROR."""


class HandshakeRefused(RemoteProtocolError):
    """The other side is not admitted.

    Args:
        reason: the reason, for people on this side.
        command: the body of the command that informs the other side.

    Attributes:
        farewell: the bytes to send before closing the connection.
    """

    def __init__(self, reason: str, command: bytes) -> None:
        super().__init__(reason)
        self.farewell: bytes = _command(command)


class Mechanism(Protocol):
    """One end's authentication and encryption on one connection."""

    @property
    def is_server(self) -> bool:
        """Whether this end is the server of the handshake."""

    @property
    def overhead(self) -> int:
        """Maximum overhead of an encrypted frame over the frame in it, in bytes."""

    def begin(self) -> bytes:
        """Return the body of this end's first command after the greetings; b"" at the server."""

    def answer(self, command: bytes, metadata: bytes) -> tuple[bytes, bytes | None]:
        """Return the body of the answer to a command, and the other side's metadata.

        The body is b"" if no answer is needed; the metadata is None until the handshake is complete.
        """

    def decrypt(self, frame: bytes) -> tuple[int, bytes]:
        """Return the flags of a frame (1: more frames follow, 2: a command) and its payload."""

    def open_message(self, data: bytes) -> tuple[bytes, bytes] | None:
        """Return the frames, without encryption, of the message of two frames that `data` is; otherwise None.

        Without a result nothing has changed, and the frames can still be passed to `decrypt`.
        """

    def seal_message(self, header: bytes, body: bytes) -> bytes | bytearray:
        """Return the bytes of a message of two frames, the first of at most 222 bytes."""

    def encode(self, frames: Sequence[bytes], flags: int = 0) -> bytearray:
        """Return the bytes of a message of at least one frame, the last of which has these flags."""


class Decoder:
    """Decoder of all bytes that one connection receives.

    Args:
        own: this end of the connection, ROUTER or DEALER; the other end has to be its partner.
        max_frame: maximum size of a frame, in bytes.
        mechanism: this end of CURVE; None for NULL.

    Attributes:
        ready: whether the handshake is complete.
    """

    def __init__(self, own: bytes, max_frame: int, mechanism: Mechanism | None = None) -> None:
        self._own = own
        self._max_frame = max_frame
        self._mechanism = mechanism
        self._buffer = b""
        self._at = 0  # offset of the first byte in the buffer that is still needed
        self._later = bytearray()  # received after the buffer, and not needed yet
        self._size = 0  # number of bytes still needed in both
        self._needed = len(GREETING)  # number of bytes needed to proceed
        self._frames: list[bytes] = []  # of an incomplete message
        self._greeted = False
        self.ready: bool = False

    def take_back(self) -> bytes:
        """Remove and return the bytes received, if they begin with an unencrypted message; otherwise b""."""
        if not self._size or not self.ready or self._frames or self._mechanism is not None:
            return b""
        data = b"".join((self._buffer[self._at :], self._later))
        self._later.clear()
        self._buffer, self._at, self._size, self._needed = b"", 0, 0, 2
        return data

    @property
    def buffered(self) -> int:
        """Number of bytes kept, waiting for more or for `next_event`; a frame counts even if it is empty."""
        frames = self._frames
        return self._size + len(frames) + sum(map(len, frames)) if frames else self._size

    @property
    def kept(self) -> int:
        """Like `buffered`, with the bytes that were read and are in memory until the rest is."""
        return len(self._buffer) + len(self._later) + len(self._frames) + sum(map(len, self._frames))

    def receive_data(self, data: bytes) -> None:
        """Add bytes received from the connection."""
        if not self._size:
            self._buffer = data
            self._at = 0
        else:
            self._later += data
        self._size += len(data)

    def next_event(self) -> list[bytes] | bytes | None:
        """Return the frames of a message, or bytes to send at once; None if more data is needed.

        The bytes may be empty: the input so far needs no reply, but there is more of it.
        Of a message of more than two frames, three are returned.

        Raises:
            HandshakeRefused: the mechanism does not admit the other side.
            RemoteProtocolError: the data is not ZMTP 3, not what the partner may send, or too large.
        """
        for _ in range(_AT_ONCE):
            if self._size < self._needed:
                return None
            if self._later:
                self._buffer = b"".join((self._buffer[self._at :], self._later))
                self._at = 0
                self._later.clear()
            if not self._greeted:
                self._check_greeting(self._take(0, len(GREETING)))
                self._greeted = True
                self._needed = SHORT_HEAD.size
                return _READY[self._own] if self._mechanism is None else _command(self._mechanism.begin())
            flags, size = SHORT_HEAD.unpack_from(self._buffer, self._at)
            start = SHORT_HEAD.size
            if flags & LONG:
                start = LONG_HEAD.size
                if self._size < start:
                    self._needed = start
                    return None
                flags, size = LONG_HEAD.unpack_from(self._buffer, self._at)
            if self._needed <= start:
                self._check_head(flags, size)
            if self._size < start + size:
                self._needed = start + size
                return None
            self._needed = SHORT_HEAD.size
            frame = self._take(start, size)
            if self._mechanism is not None:
                if not self.ready:
                    return self._shake_hands(self._mechanism, frame)
                flags, frame = self._mechanism.decrypt(frame)
                if flags > MORE:
                    if flags != _ENCRYPTED_COMMAND:
                        raise RemoteProtocolError(f"an encrypted frame cannot have the flags {flags} in it")
                    flags = COMMAND
            if flags & COMMAND:
                answer = self._obey(frame)
                if answer:
                    return answer
                continue
            frames = self._frames
            if len(frames) < _KEPT:
                frames.append(frame)
            if not flags & MORE:
                self._frames = []
                return frames
        return b""

    def _take(self, skipped: int, size: int) -> bytes:
        """Skip bytes, and return the next `size` bytes."""
        start = self._at + skipped
        self._at = end = start + size
        self._size -= skipped + size
        taken = self._buffer[start:end]
        if 2 * end >= len(self._buffer):
            # The consumed part may be large; release it.
            self._buffer = self._buffer[end:]
            self._at = 0
        return taken

    def _check_greeting(self, greeting: bytes) -> None:
        if greeting[0] != 0xFF or not greeting[9] & 1:
            raise RemoteProtocolError("it does not speak ZeroMQ's protocol")
        if greeting[10] < 3:
            raise RemoteProtocolError("it speaks a ZMTP before 3: use a ZeroMQ library from 4.0 on")
        wanted = b"NULL" if self._mechanism is None else b"CURVE"
        mechanism = greeting[12:32].rstrip(b"\0")
        if mechanism != wanted:
            raise OtherMechanism(
                f"it asks for the security mechanism {mechanism!r}; only {wanted.decode()} is supported here"
            )
        # The greeting of libzmq's server does not say that it is the server.
        if self._mechanism is not None and self._mechanism.is_server and greeting[32]:
            raise RemoteProtocolError("both sides are servers of the CURVE handshake")

    def _check_head(self, flags: int, size: int) -> None:
        if flags & ~_KNOWN_FLAGS or (flags & COMMAND and flags & MORE):
            raise RemoteProtocolError(f"a frame cannot have the flags {flags}")
        if not self.ready and not flags & COMMAND:
            raise RemoteProtocolError("a message was received before READY")
        limit = _MAX_COMMAND if flags & COMMAND else self._max_frame
        if self._mechanism is not None and self.ready:
            if flags & ~LONG:
                raise RemoteProtocolError(f"an encrypted frame cannot have the flags {flags}")
            limit += self._mechanism.overhead
        if size > limit:
            raise RemoteProtocolError(f"a frame of {size} bytes was received; {limit} are allowed")

    def _shake_hands(self, mechanism: Mechanism, command: bytes) -> bytes:
        """Act on a command of a mechanism's handshake; return the reply."""
        if command.startswith(b"\x05ERROR"):
            self._obey(command)
        answer, metadata = mechanism.answer(command, _METADATA[self._own])
        if metadata is not None:
            self._check_socket(metadata)
            self.ready = True
        return _command(answer)

    def _obey(self, command: bytes) -> bytes:
        """Act on a command; return the reply, which may be empty."""
        end = command[0] + 1 if command else 0
        name, data = command[1:end], command[end:]
        if name == b"PING":
            # A time to live of two bytes, which concerns only the sender, and a context to echo.
            pong = _name(b"PONG") + data[2:18]
            return (
                _command(pong)
                if self._mechanism is None
                else bytes(self._mechanism.encode([pong], _ENCRYPTED_COMMAND))
            )
        if name == b"READY" and self._mechanism is None:
            self._check_socket(data)
            self.ready = True
        elif name == b"ERROR":
            raise HandshakeEnded(f"it ended the handshake: {data[1:]!r:.80}")
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
