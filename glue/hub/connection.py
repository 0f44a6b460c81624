"""A connection in the hub's loop: it never waits, and keeps only what it was given to send.

A connection that is `in_turn` is served as soon as it is ready. Any other waits in the loop's queue, and is
not even watched meanwhile, so that its system holds the sender back.
"""

from __future__ import annotations

import select
import socket
import struct
import time
import traceback
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Final

from glue.hub.loop import FAILURE, READ, WRITE, Loop
from glue.sockets.options import probe_when_silent

__all__ = ["Connection", "take_leave"]

_CHUNK: Final = 65_536
"""Maximum bytes to read at once; memory for more costs a system call, even if the message is short."""

_AT_ONCE: Final = struct.pack("ii", 1, 0)
"""SO_LINGER: what is unsent is dropped, and the other side sees a reset."""


class Connection:
    """A connected socket.

    Args:
        loop: where it waits.
        connected: the socket, TCP or Unix; it is closed by `close` or `reset`.
        name: the address of the other side, for people.
        silence: seconds after which the system probes a silent host.

    Attributes:
        ready: called with the time when there is something to receive, when all has been sent, and after
            `later`. Should it raise, the connection is reset, with a report to the log.
        failed: called with the time after that.
        in_turn: whether the last message of the peer was in turn; set by the owner.
        unsent: bytes that are still to be sent, since the peer does not read.
        closed: nothing can be sent or received any more.
    """

    def __init__(self, loop: Loop, connected: socket.socket, name: str, silence: float) -> None:
        connected.setblocking(False)
        if connected.family != socket.AF_UNIX:
            connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            probe_when_silent(connected, silence)
        self.name = name
        self.ready: Callable[[float], None] = _nothing
        self.failed: Callable[[float], None] = _nothing
        self.in_turn = False
        self.closed = False
        self._loop = loop
        self._socket = connected
        self._unsent = bytearray()
        self.unsent = 0
        self._reading = True
        self._later = False
        self._queued = False
        self._finishing = False
        self._gone = False
        self._watched = READ
        loop.watch(connected.fileno(), READ, self.turn)

    def fileno(self) -> int:
        """Return the socket's descriptor."""
        return self._socket.fileno()

    @property
    def events(self) -> int:
        """The events to wait for."""
        return (READ if self._reading else FAILURE) | (WRITE if self._unsent or self._later else FAILURE)

    def read(self, wanted: bool) -> None:
        """Set whether to receive data, or to leave it where it holds the peer back."""
        if wanted != self._reading:
            self._reading = wanted
            self._watch()

    def later(self) -> None:
        """Have `ready` called again, although nothing need happen."""
        self._later = True
        self._watch()

    def receive(self) -> bytes | None:
        """Return the data received: None if none is available or reading is paused, empty at the end."""
        # What the peer sent before it went is still here.
        if not self._reading and not self._gone:
            return None
        try:
            return self._socket.recv(_CHUNK)
        except BlockingIOError:
            return None
        except OSError:
            return b""

    def send(self, data: bytes) -> None:
        """Send `data`, now or as soon as the other side reads."""
        if not self._unsent:
            sent = self._write(data)
            if sent == len(data):
                return
            data = data[sent:]
        self._unsent += data
        self.unsent = len(self._unsent)
        self._watch()

    def finish(self) -> None:
        """Close once everything is sent and the other side has closed; ignore what it still sends."""
        self._finishing = True
        self.ready = self._discard
        self.read(True)
        self._end_if_sent()

    def close(self) -> None:
        """Close, even if something is unsent."""
        if not self.closed:
            self.closed = True
            # The owner refers to this connection; break the cycle.
            self.ready = self.failed = _nothing
            self._loop.unwatch(self._socket.fileno())
            self._socket.close()

    def reset(self) -> None:
        """Close so that the next system call of the other side fails."""
        if not self.closed:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _AT_ONCE)
            self.close()

    def turn(self, now: float) -> None:
        """Serve the connection, or put it into the queue, after an event or `later`."""
        if self.in_turn:
            self.serve(now)
        elif not self._queued:
            self._queued = True
            self._loop.unwatch(self._socket.fileno())
            self._loop.queue(self._serve_from_queue)

    def serve(self, now: float) -> None:
        """Send what is left, and call `ready`."""
        if self._watched != READ:
            self._catch_up()
        try:
            self.ready(now)
        except Exception:
            failed = self.failed
            self.fail()
            failed(now)

    def fail(self) -> None:
        """Reset the connection because of the exception being handled, and report it to the log."""
        self._loop.log(
            f"{self.name} was dropped after an error of the hub; please report this:\n"
            f"{traceback.format_exc()}"
        )
        self.reset()

    def _serve_from_queue(self, now: float) -> None:
        self._queued = False
        if not self.closed:
            self._loop.watch(self._socket.fileno(), self._watched, self.turn)
            self.serve(now)

    def _catch_up(self) -> None:
        self._later = False
        if self._unsent:
            del self._unsent[: self._write(self._unsent)]
            self.unsent = len(self._unsent)
            if self._finishing:
                self._end_if_sent()
        if not self._reading and self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
            self._gone = True
        self._watch()

    def _write(self, data: bytes | bytearray) -> int:
        try:
            return self._socket.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            # Nothing may follow what is missing now. The loop reports the end.
            self._gone = True
            with suppress(OSError):  # it may have ended already
                self._socket.shutdown(socket.SHUT_RDWR)
            return len(data)

    def _watch(self) -> None:
        events = self.events
        if events != self._watched and not self.closed:
            self._watched = events
            if not self._queued:
                self._loop.watch(self._socket.fileno(), events, self.turn)

    def _end_if_sent(self) -> None:
        if not self._unsent:
            with suppress(OSError):  # the other side may be gone
                self._socket.shutdown(socket.SHUT_WR)

    def _discard(self, now: float) -> None:
        if self.receive() == b"":
            self.close()


def _nothing(now: float) -> None:
    """Do nothing."""


def take_leave(leaving: Callable[[], Iterable[Connection]], seconds: float) -> None:
    """Wait up to `seconds` until all of `leaving` are closed, so that a goodbye is read."""
    deadline = time.monotonic() + seconds
    while (now := time.monotonic()) < deadline:
        left = {connection.fileno(): connection for connection in leaving() if not connection.closed}
        if not left:
            return
        poller = select.poll()
        for fd, connection in left.items():
            poller.register(fd, connection.events)
        for fd, _ in poller.poll(int((deadline - now) * 1000) + 1):
            left[fd].serve(now)
