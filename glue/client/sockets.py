"""A DEALER on one plain, blocking socket: what peers use by default.

libzmq's own sockets need an I/O thread, two wake-ups and some twenty system calls for a message; here it is
one system call to receive it and one to send the answer. On the wire there is no difference.
"""

from __future__ import annotations

import select
import socket
import struct
import time
from collections.abc import Iterator, Mapping, Sequence
from typing import Final

from glue.client.frames import FrameTransport
from glue.client.place import needs_key
from glue.errors import Refused, RemoteProtocolError
from glue.protocol import zmtp
from glue.protocol.steps import MAX_LEAD, Step, StepFormat, lead_of
from glue.sockets.looking import receive_soon
from glue.sockets.options import limit_silence, probe_when_silent, unix_address

__all__ = ["SocketTransport"]

_CHUNK: Final = 65_536
"""Bytes received at once, at most; a larger buffer would cost a system call to allocate."""

_JOINED: Final = 65_536
"""Bytes of a body up to which it is joined with what comes before it, which is cheaper than two buffers."""

_RETRY_SECONDS: Final = (0.05, 1.0)
"""How long to wait before connecting again: after the first failure, and at most."""

_LINGER_SECONDS: Final = 1.0
"""How long `close` waits for the hub to read what was sent last."""


class SocketTransport(FrameTransport):
    """A connection to a hub, made again whenever it breaks.

    Args:
        url: `tcp://HOST:PORT` or `ipc://PATH`.
        timeout: seconds after which a connection attempt, a handshake or unacknowledged data have failed.
        max_frame: bytes of the largest frame that is accepted.

    Attributes:
        connected: whether there is a connection, its handshake complete.
        connections: how many there have been, this one included.
        problem: why the latest one failed, if the other end does not speak ZeroMQ's protocol.
    """

    def __init__(self, url: str, timeout: float, max_frame: int) -> None:
        self.connected = False
        self.connections = 0
        self.problem: str | None = None
        self._url = url
        self._timeout = timeout
        self._max_frame = max_frame
        self._wait = timeout
        self._socket: socket.socket | None = None  # connected or connecting
        self._decoder = zmtp.Decoder(zmtp.DEALER, max_frame)
        self._greeted = False
        self._deadline = 0.0  # of the handshake
        self._retry = _RETRY_SECONDS[0]
        self._retry_at = 0.0
        self._timed_out = False
        self._look = 0.0

    def notice_connections(self) -> None:
        """Do nothing: `connected` and `connections` are up to date at any time."""

    def wait_at_most(self, seconds: float) -> None:
        """Set how long `receive` waits, in seconds."""
        self._wait = seconds
        if self.connected:
            self._limit_receiving()

    def look_for(self, seconds: float) -> None:
        """Set how long `receive` looks for a message before it falls asleep, in seconds."""
        self._look = seconds

    def send(self, frames: Sequence[bytes]) -> bool:
        """Send a message; return False, having sent nothing, if there is no connection."""
        return self.send_data(*zmtp.encode_parts(frames))

    def send_data(self, head: bytes, body: bytes) -> bool:
        """Send the bytes of a message, what comes before the last frame's content and that; as `send`."""
        if not self.connected:
            return False
        if len(body) <= _JOINED:
            return self._send(head + body)
        connected = self._socket
        assert connected is not None
        try:
            sent = connected.sendmsg((head, body), (), socket.MSG_DONTWAIT)
        except BlockingIOError:
            sent = 0
        except OSError:
            self._fail()
            return False
        rest = [memoryview(head)[sent:], memoryview(body)[max(0, sent - len(head)) :]]
        return all(self._send_rest(connected, part) for part in rest)

    def receive(self) -> list[bytes] | None:
        """Return the next message; None if none arrived in time, or as soon as there is a connection.

        Raises:
            Refused: the hub lets in only peers whose keys it knows.
        """
        if self._timed_out:
            self._timed_out = False
            return None
        while True:
            try:
                event = self._decoder.next_event()
            except zmtp.OtherMechanism:
                self._fail()
                raise Refused(needs_key(self._url)) from None
            except RemoteProtocolError as error:
                self.problem = str(error)
                self._fail()
                return None
            if self._decoder.ready and not self.connected:
                self._begin()
                if event is None:
                    return None
            if isinstance(event, list):
                return event
            if event is not None:
                self._send(event)
            else:
                data = self._receive_data() if self.connected else self._shake_hands()
                if data is None:
                    return None
                self._decoder.receive_data(data)

    def receive_steps(self, form: StepFormat, after: int, limit: int) -> Iterator[Step]:
        """Yield one message of `form` after the other, until something else arrives, or nothing in time.

        What that was, `receive` returns.

        Args:
            form: the format of the messages.
            after: a sequence number that all of theirs are larger than.
            limit: bytes of the longest message.
        """
        decode = form.decode
        while self._decoder.between_messages:
            data = self._receive_data()
            if data is None:
                self._timed_out = True
                return
            found = decode(data) if len(data) <= limit else None
            if found is None or found[1] != len(data) or found[0][0] <= after:
                self._decoder.receive_data(data)
                return
            step = found[0]
            after = step[0]
            yield step

    def receive_batches(
        self, forms: Mapping[bytes, StepFormat], limit: int
    ) -> Iterator[list[tuple[StepFormat, Step]]]:
        """Yield the messages received at once, until something else arrives, or nothing in time.

        What that was, `receive` returns.

        Args:
            forms: the formats of the messages, by their lead.
            limit: bytes of the longest body.
        """
        decoder = self._decoder
        while decoder is self._decoder:  # the connection is still the same
            if lead_of(decoder.peek(MAX_LEAD), 0) in forms:
                data = decoder.take_back()
            elif not decoder.between_messages:
                return
            else:
                received = self._receive_data()
                if received is None:
                    self._timed_out = True
                    return
                data = received
            steps: list[tuple[StepFormat, Step]] = []
            at = 0
            while (form := forms.get(lead_of(data, at))) is not None:
                found = form.decode(data, at)
                if found is None or len(found[0][2]) > limit:
                    break
                steps.append((form, found[0]))
                at = found[1]
            decoder.receive_data(data[at:])
            if not steps:
                return
            yield steps

    def close(self, linger: float | None = None) -> None:
        """Close, giving the hub at most `linger` seconds (by default one) to read what was sent last."""
        connected, self._socket = self._socket, None
        linger = _LINGER_SECONDS if linger is None else linger
        if connected is None:
            return
        with connected:
            # What is closed with data unread is reset, and a reset discards what the hub has not read.
            if linger and self.connected:
                deadline = time.monotonic() + linger
                try:
                    connected.shutdown(socket.SHUT_WR)
                    while (left := deadline - time.monotonic()) > 0:
                        connected.settimeout(left)
                        if not connected.recv(_CHUNK):
                            break
                except OSError:
                    pass

    def _receive_data(self) -> bytes | None:
        connected = self._socket
        assert connected is not None
        try:
            data = receive_soon(connected, _CHUNK, self._look) if self._look else None
            if data is None:
                data = connected.recv(_CHUNK)
        except BlockingIOError:
            return None
        except OSError:
            data = b""
        if not data:
            self._fail()
            return None
        return data

    def _send(self, data: bytes) -> bool:
        connected = self._socket
        assert connected is not None
        try:
            sent = connected.send(data, socket.MSG_DONTWAIT)
        except BlockingIOError:
            sent = 0
        except OSError:
            self._fail()
            return False
        return sent == len(data) or self._send_rest(connected, memoryview(data)[sent:])

    def _send_rest(self, connected: socket.socket, rest: memoryview) -> bool:
        """Send what the hub has no room for yet; it may have to be read first, as we have."""
        poller = select.poll()
        while rest:
            crowded = self._decoder.buffered > 2 * self._max_frame
            poller.register(connected, select.POLLOUT if crowded else select.POLLIN | select.POLLOUT)
            _, events = poller.poll()[0]
            try:
                if events & select.POLLOUT:
                    rest = rest[connected.send(rest, socket.MSG_DONTWAIT) :]
                else:
                    data = connected.recv(_CHUNK)
                    if not data:
                        raise ConnectionResetError
                    self._decoder.receive_data(data)
            except BlockingIOError:
                continue
            except OSError:
                self._fail()
                return False
        return True

    # Making a connection, in steps of which none waits for longer than `receive` may.

    def _shake_hands(self) -> bytes | None:
        """Take the next step towards a connection; return what arrived, or None if it is not the time yet."""
        now = time.monotonic()
        if self._socket is None:
            if now < self._retry_at:
                time.sleep(min(self._retry_at - now, self._wait))
                return None
            self._deadline = now + self._timeout
            self._greeted = False
        try:
            if self._socket is None:
                self._socket = _connect(self._url)
            left = max(0.0, self._deadline - now)
            if not _wait_for(self._socket, self._greeted, min(left, self._wait)):
                if left <= self._wait:
                    self._fail()
                return None
            if self._greeted:
                data = self._socket.recv(_CHUNK)
                if not data:
                    raise ConnectionResetError
                return data
            self._socket.send(zmtp.GREETING)
            self._greeted = True
            return b""
        except OSError:
            self._fail()
            return None

    def _begin(self) -> None:
        """Begin on a connection whose handshake is complete."""
        assert self._socket is not None
        self.connected = True
        self.connections += 1
        self.problem = None
        self._retry = _RETRY_SECONDS[0]
        self._socket.setblocking(True)
        probe_when_silent(self._socket, self._timeout)
        limit_silence(self._socket, self._timeout)
        self._limit_receiving()

    def _limit_receiving(self) -> None:
        # The socket's own limit: Python's would add a poll to every system call.
        assert self._socket is not None
        seconds, rest = divmod(max(self._wait, 0.001), 1)
        limit = struct.pack("@ll", int(seconds), int(rest * 1e6))
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVTIMEO, limit)

    def _fail(self) -> None:
        """Close what is left of a connection, and connect again in a while."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        self.connected = False
        self._decoder = zmtp.Decoder(zmtp.DEALER, self._max_frame)
        self._retry_at = time.monotonic() + self._retry
        self._retry = min(2 * self._retry, _RETRY_SECONDS[1])


def _connect(url: str) -> socket.socket:
    """Return a socket that is connecting to a hub.

    Raises:
        OSError: it cannot.
    """
    scheme, _, rest = url.partition("://")
    if scheme == "ipc":
        family = socket.AF_UNIX
        address: tuple[str | int, ...] | str | tuple[int, bytes] = unix_address(rest)
    else:
        host, _, port = rest.rpartition(":")
        family = socket.AF_INET6 if host.startswith("[") else socket.AF_INET
        address = socket.getaddrinfo(host.strip("[]"), int(port), family, socket.SOCK_STREAM)[0][4]
    connecting = socket.socket(family)
    try:
        connecting.setblocking(False)
        if family != socket.AF_UNIX:
            connecting.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connecting.connect(address)
    except BlockingIOError:
        pass  # under way
    except OSError:
        connecting.close()
        raise
    return connecting


def _wait_for(waiting: socket.socket, readable: bool, seconds: float) -> bool:
    """Return whether a socket becomes readable, or else writable, in time."""
    poller = select.poll()
    poller.register(waiting, select.POLLIN if readable else select.POLLOUT)
    return bool(poller.poll(seconds * 1000))
