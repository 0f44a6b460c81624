"""A peer of a hub, driven byte by byte or message by message, in plain text or with keys, in any role.

It is a DEALER written from RFC 23 and RFC 26: it shares the message codec with the clients of this project,
but none of their connection code.
"""

from __future__ import annotations

import os
import select
import socket
import struct
from contextlib import suppress
from typing import Any, Final, Self

from glue.hub.sessions import INSTANCE_SIZE
from glue.wire.codec import FROM_HUB, TO_HUB, decode, encode
from glue.wire.messages import PROTOCOL_VERSION, Kind, Message
from tests.scripted import curve
from tests.scripted.curve import METADATA, CurveClient, command

GREETING: Final = b"\xff" + bytes(8) + b"\x7f\x03\x01" + b"NULL".ljust(20, b"\0") + bytes(32)
READY: Final = command(b"\x05READY" + METADATA)

ABORT: Final = struct.pack("ii", 1, 0)
"""SO_LINGER: closing drops unsent data and resets the connection, as a killed machine does."""

TIMEOUT: Final = 60.0
"""Seconds until a test gives up waiting for another process; generous, as machines are busy."""

_MORE, _LONG, _COMMAND = 1, 2, 4


def framed(*frames: bytes) -> bytes:
    """Return a message as ZMTP's bytes."""
    parts = []
    for left, frame in zip(range(len(frames))[::-1], frames, strict=True):
        more = _MORE if left else 0
        short = len(frame) < 256
        parts += [bytes((more, len(frame))) if short else struct.pack(">BQ", more | _LONG, len(frame)), frame]
    return b"".join(parts)


def hello_scalars(
    role: str, name: str = "scripted", abilities: tuple[str, ...] = (), instance: bytes | None = None
) -> tuple[Any, ...]:
    """Return the scalars of a HELLO, by default from an instance that no hub has seen."""
    instance = os.urandom(INSTANCE_SIZE) if instance is None else instance
    return (PROTOCOL_VERSION,), role, instance, name, "test", abilities


class ScriptedPeer:
    """One connection at a time to a hub.

    Args:
        url: address of the hub, of scheme `tcp` or `ipc`.
        keys: the client's half of CURVE; without it, nothing is encrypted.
        session: name of the session of its messages, unless a message names another.
        timeout: seconds that the hub may take for each read and write.
        receive_buffer: size in bytes of the kernel's receive buffer; 0 for the system's choice.
    """

    def __init__(
        self,
        url: str,
        keys: CurveClient | None = None,
        *,
        session: str = "default",
        timeout: float = TIMEOUT,
        receive_buffer: int = 0,
    ) -> None:
        self.url = url
        self.keys = keys
        self.session = session
        self.timeout = timeout
        self.buffer = bytearray()
        self._connected: socket.socket | None = None
        self._receive_buffer = receive_buffer
        self._instance = os.urandom(INSTANCE_SIZE)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection, if there is one."""
        if self._connected is not None:
            self._connected.close()

    @property
    def socket(self) -> socket.socket:
        """The socket of the connection."""
        assert self._connected is not None
        return self._connected

    # Bytes

    def connect(self) -> Self:
        """Close the previous connection and open a new one, without sending anything."""
        self.close()
        self.buffer.clear()
        scheme, _, rest = self.url.partition("://")
        host, _, port = rest.rpartition(":")
        self._connected = socket.socket(socket.AF_UNIX if scheme == "ipc" else socket.AF_INET)
        self.socket.settimeout(self.timeout)
        if scheme == "tcp":
            self.socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        if self._receive_buffer:
            self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, self._receive_buffer)
        self.socket.connect(rest if scheme == "ipc" else (host, int(port)))
        return self

    def send_bytes(self, data: bytes) -> None:
        """Send bytes."""
        self.socket.sendall(data)

    def fill(self) -> None:
        """Wait for bytes, and put them into the buffer.

        Raises:
            ConnectionError: the hub has ended the connection.
        """
        more = self.socket.recv(65536)
        if not more:
            raise ConnectionAbortedError("the hub has ended the connection")
        self.buffer += more

    def read(self, size: int) -> bytes:
        """Return exactly `size` bytes."""
        while len(self.buffer) < size:
            self.fill()
        data = bytes(self.buffer[:size])
        del self.buffer[:size]
        return data

    def read_to_end(self) -> bytes:
        """Return all bytes until the hub ends the connection."""
        with suppress(ConnectionError):
            while True:
                self.fill()
        return self.read(len(self.buffer))

    def can_read(self, seconds: float) -> bool:
        """Return whether there are bytes to read within some seconds."""
        return bool(self.buffer or select.select([self.socket], [], [], seconds)[0])

    # Frames

    def greet(self) -> Self:
        """Connect, and carry out the handshake."""
        self.connect()
        if self.keys is None:
            self.send_bytes(GREETING)
            self.read(len(GREETING))
            self.send_bytes(READY)
            self.read_frame()
        else:
            self.send_bytes(curve.GREETING)
            self.read(len(curve.GREETING))
            self.send_bytes(command(self.keys.hello()))
            self.keys.welcome(self.read_frame()[1])
            self.send_bytes(command(self.keys.initiate()))
            self.keys.ready(self.read_frame()[1])
        return self

    def read_head(self) -> tuple[int, int]:
        """Return a frame's flags and size."""
        flags, size = self.read(2)
        return flags, size if not flags & _LONG else int.from_bytes(bytes((size,)) + self.read(7))

    def read_frame(self) -> tuple[int, bytes]:
        """Return a frame's flags and data."""
        flags, size = self.read_head()
        return flags, self.read(size)

    def receive_frames(self) -> list[bytes]:
        """Return the frames of the next message; PINGs are answered."""
        frames = []
        while True:
            flags, data = self.read_frame()
            if flags & _COMMAND:
                self.pinged(data)
                continue
            if self.keys is not None:
                flags, data = self.keys.read(data)
            frames.append(data)
            if not flags & _MORE:
                return frames

    def pinged(self, body: bytes) -> None:
        """Answer a PING, which has a time to live and a context, with its context."""
        if body.startswith(b"\x04PING"):
            self.send_bytes(command(b"\x04PONG" + body[7:]))

    def encoded(self, *frames: bytes) -> bytes:
        """Return a message as bytes, encoded for this connection."""
        if self.keys is None:
            return framed(*frames)
        last = len(frames) - 1
        return b"".join(self.keys.message(frame, _MORE * (at < last)) for at, frame in enumerate(frames))

    def send(self, *frames: bytes) -> None:
        """Send any frames as a message."""
        self.send_bytes(self.encoded(*frames))

    # Messages

    def frames_of(
        self, kind: Kind, seq: int, *scalars: Any, body: bytes = b"", session: str | None = None
    ) -> tuple[bytes, ...]:
        """Return the frames of a message."""
        named = self.session if session is None else session
        return encode(Message(kind, named, seq, scalars, body), TO_HUB)

    def say(self, kind: Kind, seq: int, *scalars: Any, body: bytes = b"", session: str | None = None) -> None:
        """Send a message."""
        self.send(*self.frames_of(kind, seq, *scalars, body=body, session=session))

    def receive(self) -> Message:
        """Return the next message that is not a heartbeat."""
        while (message := decode(self.receive_frames(), FROM_HUB)).kind is Kind.HEARTBEAT:
            pass
        return message

    def hello(self, role: str, *, session: str | None = None, abilities: tuple[str, ...] = ()) -> None:
        """Send HELLO, always as the same instance."""
        scalars = hello_scalars(role, abilities=abilities, instance=self._instance)
        self.say(Kind.HELLO, 0, *scalars, session=session)

    def join(self, role: str, *, session: str | None = None) -> Message:
        """Send HELLO; return the WELCOME."""
        self.hello(role, session=session)
        welcome = self.receive()
        assert welcome.kind is Kind.WELCOME, welcome
        return welcome
