"""A connection in the hub's loop: it never blocks, and keeps only data to send.

A connection that is `in_turn` is served as soon as it is ready. Any other connection waits in the loop's
queue, and is not even watched meanwhile, so that the kernel holds the sender back.
"""

from __future__ import annotations

import traceback
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Final

from glue.hub.io.loop import FAILURE, READ, WRITE, Loop
from glue.system import clock, network
from glue.system.sockets import never_wait, probe_when_silent, reset_when_closed

_CHUNK: Final = 65_536
"""Maximum bytes to read at once; a larger buffer costs a system call, even if the message is short."""

_PIECE: Final = 65_536
"""Size in bytes from which unsent data is kept as it is; less is copied into pieces of about this size."""


class Owner:
    """The owner of a connection, which handles its events; this one does nothing."""

    def ready(self, now: float) -> None:
        """Handle the connection: it has data to receive, everything has been sent, or `later` was called.

        If it raises, the error is logged and the connection reset.
        """

    def failed(self, now: float) -> None:
        """Forget the connection, which was reset because `ready` raised."""


class Connection:
    """A connected socket.

    Args:
        loop: the event loop that it waits in.
        connected: the socket, TCP or Unix; it is closed by `close` or `reset`.
        name: the address of the other side, for people.
        silence: seconds after which the system probes a silent host.

    Attributes:
        owner: handler of the connection's events; set by the owner itself.
        in_turn: whether the last message of the peer was in turn; set by the owner.
        unsent: number of bytes kept until they are sent, as the peer does not read; 0 if all are sent. Of a
            large piece of data, the part that has been sent counts too: it is kept until the rest is sent.
        reading: whether data is received; set by `read`.
        closed: whether the connection is closed.
    """

    def __init__(self, loop: Loop, connected: network.socket, name: str, silence: float) -> None:
        never_wait(connected)
        probe_when_silent(connected, silence)
        self.name = name
        self.owner: Owner = _NOBODY
        self.in_turn = False
        self.closed: bool = False
        self._loop = loop
        self._socket = connected
        self._unsent: deque[bytes | bytearray] = deque()
        self._sent = 0  # number of bytes of the first unsent piece that have been sent
        self.unsent: int = 0
        self.reading: bool = True
        self._later = False
        self._queued = False
        self._finishing = False
        self._gone = False
        self._glanced: bytes | None = None
        self._watched = READ
        loop.watch(connected.fileno(), READ, self)

    def fileno(self) -> int:
        """Return the socket's descriptor."""
        return self._socket.fileno()

    @property
    def events(self) -> int:
        """The events to wait for."""
        return (READ if self.reading else FAILURE) | (WRITE if self._unsent or self._later else FAILURE)

    def read(self, wanted: bool) -> None:
        """Set whether to receive data, or to leave it unread, which holds the peer back."""
        if wanted != self.reading:
            self.reading = wanted
            self._watch()

    def later(self) -> None:
        """Give the owner another turn, even if there is no event."""
        self._later = True
        self._watch()

    def receive(self) -> bytes | None:
        """Return the data received: None if none is available or reading is paused, empty at the end."""
        data, self._glanced = self._glanced, None
        # Data that the peer sent before it went can still be read.
        if data is None and (self.reading or self._gone):
            try:
                data = self._socket.recv(_CHUNK)
            except BlockingIOError:
                pass
            except OSError:
                data = self._failed_to_receive()
        return data

    def glance(self) -> bool | None:
        """Receive data for `receive` to return, and return whether a turn is due; None without data."""
        if self._glanced is None and self.reading and not self.closed:
            try:
                self._glanced = self._socket.recv(_CHUNK)
            except BlockingIOError:
                return None
            except OSError:
                self._glanced = self._failed_to_receive()
        return not (self.closed or self._queued)

    def send(self, data: bytes | bytearray) -> None:
        """Send `data`, now or as soon as the other side reads; it must not be changed any more."""
        pieces = self._unsent
        if not pieces:
            try:
                self._sent = self._socket.send(data)
            except OSError as error:
                self._sent = self._failed_to_send(error, data)
            if self._sent == len(data):
                return
        if len(data) >= _PIECE:
            pieces.append(data)
        elif pieces and type(last := pieces[-1]) is bytearray and len(last) < _PIECE:
            last += data
        else:
            pieces.append(bytearray(data))
        self.unsent += len(data)
        self._watch()

    def finish(self) -> None:
        """Close once everything is sent and the other side has closed; ignore data that it still sends."""
        self._finishing = True
        self.owner = _Discarding(self)
        self.read(True)
        self._end_if_sent()

    def close(self) -> None:
        """Close, even if data is unsent."""
        if not self.closed:
            self.closed = True
            # The owner refers to this connection; break the cycle.
            self.owner = _NOBODY
            self._glanced = None
            self._unsent.clear()
            self.unsent = 0
            self._loop.unwatch(self._socket.fileno())
            self._socket.close()

    def reset(self) -> None:
        """Close so that the next system call of the other side fails."""
        if not self.closed:
            reset_when_closed(self._socket)
            self.close()

    def turn(self, now: float, at_once: bool = False) -> None:
        """Send unsent data and let the owner act; a connection that is out of turn is queued first."""
        if not self.in_turn and not at_once:
            if not self._queued:
                self._queued = True
                self._loop.unwatch(self._socket.fileno())
                self._loop.queue(self._turn_of_queue)
            return
        if self._watched != READ:
            self._catch_up()
        try:
            self.owner.ready(now)
        except Exception:
            owner = self.owner
            self.fail()
            owner.failed(now)

    def fail(self) -> None:
        """Reset the connection because of the exception being handled, and report it to the log."""
        self._loop.log(
            f"{self.name} was dropped after an error of the hub; please report this:\n"
            f"{traceback.format_exc()}"
        )
        self.reset()

    def _turn_of_queue(self, now: float) -> None:
        self._queued = False
        if not self.closed:
            self._loop.watch(self._socket.fileno(), self._watched, self)
            self.turn(now, at_once=True)

    def _catch_up(self) -> None:
        self._later = False
        pieces = self._unsent
        if pieces:
            rest = memoryview(pieces[0])[self._sent :]
            try:
                sent = self._socket.send(rest)
            except OSError as error:
                sent = self._failed_to_send(error, rest)
            self._sent += sent
            if sent == len(rest):
                self._sent = 0
                self.unsent -= len(pieces.popleft())
            if self._finishing:
                self._end_if_sent()
        if not self.reading and self._socket.getsockopt(network.SOL_SOCKET, network.SO_ERROR):
            self._gone = True
        self._watch()

    def _failed_to_receive(self) -> bytes:
        """Return the end of the data, also to a later `receive`: unlike a closed half, a reset ends both."""
        self._gone = True
        return b""

    def _failed_to_send(self, error: OSError, data: bytes | bytearray | memoryview) -> int:
        """Return how many bytes of `data` need not be sent any more: all, if the other side is gone."""
        if isinstance(error, BlockingIOError):
            return 0
        # No data may follow the missing bytes. The loop reports the end.
        self._gone = True
        with suppress(OSError):  # it may have ended already
            self._socket.shutdown(network.SHUT_RDWR)
        return len(data)

    def _watch(self) -> None:
        events = self.events
        if events != self._watched and not self.closed:
            self._watched = events
            if not self._queued:
                self._loop.watch(self._socket.fileno(), events, self)

    def _end_if_sent(self) -> None:
        if not self._unsent:
            with suppress(OSError):  # the other side may be gone
                self._socket.shutdown(network.SHUT_WR)


_NOBODY: Final = Owner()


class _Discarding(Owner):
    """The owner of a connection that only waits for the other side to close."""

    def __init__(self, connection: Connection) -> None:
        self._connection = connection

    def ready(self, now: float) -> None:
        """Ignore received data."""
        if self._connection.receive() == b"":
            self._connection.close()


def take_leave(leaving: Callable[[], Iterable[Connection]], seconds: float) -> None:
    """Wait up to `seconds` until all of `leaving` are closed, so that a goodbye is read."""
    deadline = clock.monotonic() + seconds
    while (now := clock.monotonic()) < deadline:
        left = {connection.fileno(): connection for connection in leaving() if not connection.closed}
        if not left:
            return
        poller = network.poll()
        for fd, connection in left.items():
            poller.register(fd, connection.events)
        for fd, _ in poller.poll(int((deadline - now) * 1000) + 1):
            left[fd].turn(now, at_once=True)
