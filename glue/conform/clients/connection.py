"""The kit's end of a client's connection: a ROUTER that can send any bytes."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from glue.conform.rules import Broken
from glue.errors import RemoteProtocolError
from glue.system import clock, network
from glue.system.sockets import never_wait, reset_when_closed, wait_for
from glue.wire import zmtp
from glue.wire.messages import MAX_FRAME

_CHUNK: Final = 65_536


class Gone(Exception):
    """The client closed the connection."""


class Listener:
    """The kit's listening socket; it can be closed and opened again at the same address.

    Args:
        scheme: `tcp` or `ipc`.
    """

    def __init__(self, scheme: str) -> None:
        # Not glue-...: runs of earlier versions connect to the sockets in such folders.
        self._folder = tempfile.TemporaryDirectory(prefix="conform-") if scheme == "ipc" else None
        self._path = None if self._folder is None else Path(self._folder.name) / "hub"
        self._port = 0
        self._socket: network.socket | None = None
        self.open()

    @property
    def url(self) -> str:
        """The address for a client."""
        return f"tcp://127.0.0.1:{self._port}" if self._path is None else f"ipc://{self._path}"

    def open(self) -> None:
        """Listen."""
        if self._path is None:
            self._socket = network.create_server(("127.0.0.1", self._port))
            self._port = self._socket.getsockname()[1]
        else:
            self._socket = network.socket(network.AF_UNIX)
            self._socket.bind(str(self._path))
            self._socket.listen()

    def close(self) -> None:
        """Stop listening, and drop pending connections."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
            if self._path is not None:
                self._path.unlink()

    def remove(self) -> None:
        """Close, and remove the socket's folder."""
        self.close()
        if self._folder is not None:
            self._folder.cleanup()

    def accept(self, wait: float) -> Connection | None:
        """Return the next connection; None if there is none within `wait` seconds."""
        if not self.waits(wait):
            return None
        assert self._socket is not None
        return Connection(self._socket.accept()[0])

    def waits(self, seconds: float) -> bool:
        """Return whether a connection can be accepted within `seconds`."""
        assert self._socket is not None
        return wait_for(self._socket, network.POLLIN, seconds)


class Connection:
    """One connection."""

    def __init__(self, connected: network.socket) -> None:
        never_wait(connected)
        self._socket = connected
        self._decoder = zmtp.Decoder(zmtp.ROUTER, MAX_FRAME)
        self._raw = b""  # bytes received in the handshake
        self._early: list[bytes] | None = None  # a message received along with READY
        self._heard = b""  # bytes received recently

    def greet(self, wait: float, hold: float = 0.0) -> None:
        """Carry out ZMTP's handshake, with READY delayed by `hold` seconds.

        Raises:
            Broken: the client does not complete it within `wait` seconds.
            Gone: the client closes the connection.
        """
        deadline = clock.monotonic() + wait
        self.send_bytes(zmtp.GREETING)
        while not self._decoder.ready:
            try:
                event = self._decoder.next_event()
            except RemoteProtocolError as error:
                raise Broken(
                    "ZMTP's greeting, then READY of a DEALER", f"a client of which {error}", [self._raw]
                ) from None
            if isinstance(event, list):
                self._early = event
            elif event is not None:
                if hold:
                    self._hold_back(hold)
                self.send_bytes(event)
            elif not self._decoder.ready and not self._read(deadline):
                raise Broken("ZMTP's greeting, then READY of a DEALER", "nothing more in time", [self._raw])

    def _hold_back(self, seconds: float) -> None:
        deadline = clock.monotonic() + seconds
        while self._read(deadline):
            pass
        ahead = self._raw[len(zmtp.GREETING) :]
        if ahead and (len(ahead) < 2 or len(ahead) != 2 + ahead[1]):
            raise Broken("READY and nothing more before the hub's READY", "other bytes", [ahead])

    def send(self, frames: Sequence[bytes]) -> None:
        """Send a message."""
        self.send_bytes(zmtp.encode(frames))

    def send_bytes(self, data: bytes, wait: float = 30.0) -> None:
        """Send bytes, receiving meanwhile.

        Raises:
            Gone: the client closed the connection.
            Broken: the client reads nothing.
        """
        rest = memoryview(data)
        deadline = clock.monotonic() + wait
        while rest:
            try:
                rest = rest[self._socket.send(rest) :]
            except BlockingIOError:
                wait_for(self._socket, network.POLLIN | network.POLLOUT, 1.0)
                self._read(clock.monotonic())
                if clock.monotonic() > deadline:
                    raise Broken("a client that reads", f"{len(rest)} bytes that it has not read") from None
            except OSError:
                raise Gone from None

    def receive(self, wait: float) -> list[bytes] | None:
        """Return the frames of the next message; None if there is none within `wait` seconds.

        Raises:
            Gone: the client closed the connection.
            Broken: the bytes received are not ZMTP.
        """
        deadline = clock.monotonic() + wait
        if self._early is not None:
            early, self._early = self._early, None
            return early
        while True:
            try:
                event = self._decoder.next_event()
            except RemoteProtocolError as error:
                raise Broken("frames of ZMTP", str(error)) from None
            if isinstance(event, list):
                return event
            if event:
                self.send_bytes(event)
            elif event is None and not self._read(deadline):
                return None

    def hears(self, data: bytes, wait: float) -> bool:
        """Return whether these bytes, such as a command, are received within `wait` seconds."""
        deadline = clock.monotonic() + wait
        self._heard = b""
        while data not in self._heard:
            if not self._read(deadline):
                return False
            while self._decoder.next_event() is not None:
                pass
        return True

    def receive_bytes(self, wait: float) -> bytes:
        """Return bytes as they are received; empty if none arrive in time.

        Only for use while no message is under way.
        """
        wait_for(self._socket, network.POLLIN, wait)
        try:
            data = self._socket.recv(_CHUNK)
        except BlockingIOError:
            return b""
        except OSError:
            raise Gone from None
        if not data:
            raise Gone
        return data

    def ends(self, wait: float) -> bool:
        """Return whether the client closes the connection within `wait` seconds; messages are ignored."""
        deadline = clock.monotonic() + wait
        try:
            while clock.monotonic() < deadline:
                self.receive_bytes(deadline - clock.monotonic())
        except Gone:
            return True
        return False

    def close(self, reset: bool = False) -> None:
        """Close the connection; with `reset`, as when a program is killed."""
        if reset:
            reset_when_closed(self._socket)
        self._socket.close()

    def _read(self, deadline: float) -> bool:
        data = self.receive_bytes(deadline - clock.monotonic())
        if not self._decoder.ready:
            self._raw += data
        self._heard += data
        self._decoder.receive_data(data)
        return bool(data)
