"""A connection in the hub's loop: it never waits, and keeps only what it was given to send."""

from __future__ import annotations

import select
import socket
import struct
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Final

from glue.hub.loop import FAILURE, READ, WRITE, Loop

__all__ = ["Connection", "limit_patience", "take_leave"]

_CHUNK: Final = 65_536
"""The most bytes that are read at once; beyond it, memory for a short message would cost a system call."""

_PROBES: Final = 3
"""Unanswered probes, one a heartbeat, after which a host that fell silent is taken for gone."""

_LONGEST_SILENCE: Final = 32_767
"""Seconds; Linux, MAX_TCP_KEEPIDLE."""

_AT_ONCE: Final = struct.pack("ii", 1, 0)
"""SO_LINGER: what is unsent is dropped, and the other side sees a reset."""


class Connection:
    """A connected socket.

    Args:
        loop: where it waits.
        connected: the socket, TCP or Unix; it is closed by `close` or `reset`.
        name: the other side's address, for people.
        silence: seconds after which a silent host is asked whether it is still there.

    Attributes:
        ready: called with the time when something has come, when all has been sent, and after `later`.
        closed: nothing can be sent or received any more.
    """

    def __init__(self, loop: Loop, connected: socket.socket, name: str, silence: float) -> None:
        connected.setblocking(False)
        if connected.family != socket.AF_UNIX:
            connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            _probe_when_silent(connected, min(max(1, round(silence)), _LONGEST_SILENCE))
        self.name = name
        self.ready: Callable[[float], None] = _nothing
        self.closed = False
        self._loop = loop
        self._socket = connected
        self._unsent = bytearray()
        self._reading = True
        self._later = False
        self._finishing = False
        self._gone = False
        self._watched = READ
        loop.watch(connected.fileno(), READ, self.turn)

    def fileno(self) -> int:
        """Return the socket's descriptor."""
        return self._socket.fileno()

    @property
    def events(self) -> int:
        """What there is to wait for."""
        return (READ if self._reading else FAILURE) | (WRITE if self._unsent or self._later else FAILURE)

    @property
    def unsent(self) -> int:
        """Bytes that were sent and are still here, since the other side does not read."""
        return len(self._unsent)

    def read(self, wanted: bool) -> None:
        """Say whether what comes is to be received, or left where it holds the other side back."""
        if wanted != self._reading:
            self._reading = wanted
            self._watch()

    def later(self) -> None:
        """Have `ready` called in the next turn of the loop."""
        self._later = True
        self._watch()

    def receive(self) -> bytes | None:
        """Return what has come: None if nothing did, or is wanted; no bytes if nothing will any more."""
        # Whoever is gone may have said something before, which is still here.
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
        self._watch()

    def finish(self) -> None:
        """Close as soon as everything is sent and the other side has closed; drop what it still says."""
        self._finishing = True
        self.ready = self._discard
        self.read(True)
        self._end_if_sent()

    def close(self) -> None:
        """Close in the orderly way, whatever is still unsent."""
        if not self.closed:
            self.closed = True
            # Whoever was called keeps this connection, and would be kept by it.
            self.ready = _nothing
            self._loop.unwatch(self._socket.fileno())
            self._socket.close()

    def reset(self) -> None:
        """Close so that the other side's next call fails, whatever it was going to do."""
        if not self.closed:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _AT_ONCE)
            self.close()

    def turn(self, now: float) -> None:
        """Send what is left, and call `ready`: something has happened, or `later` was called."""
        if self._watched != READ:
            self._catch_up()
        self.ready(now)

    def _catch_up(self) -> None:
        self._later = False
        if self._unsent:
            del self._unsent[: self._write(self._unsent)]
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
            # Nothing may follow what is missing now. The loop hears of the end.
            self._gone = True
            with suppress(OSError):  # it may have ended already
                self._socket.shutdown(socket.SHUT_RDWR)
            return len(data)

    def _watch(self) -> None:
        events = self.events
        if events != self._watched and not self.closed:
            self._watched = events
            self._loop.watch(self._socket.fileno(), events, self.turn)

    def _end_if_sent(self) -> None:
        if not self._unsent:
            with suppress(OSError):  # the other side may be gone
                self._socket.shutdown(socket.SHUT_WR)

    def _discard(self, now: float) -> None:
        if self.receive() == b"":
            self.close()


def _nothing(now: float) -> None:
    """Do nothing, when nobody waits for a connection."""


def take_leave(leaving: Callable[[], Iterable[Connection]], seconds: float) -> None:
    """Wait until none of `leaving` is left open, at most so many seconds: last words should be read."""
    deadline = time.monotonic() + seconds
    while (now := time.monotonic()) < deadline:
        left = {connection.fileno(): connection for connection in leaving() if not connection.closed}
        if not left:
            return
        poller = select.poll()
        for fd, connection in left.items():
            poller.register(fd, connection.events)
        for fd, _ in poller.poll(int((deadline - now) * 1000) + 1):
            left[fd].turn(now)


def limit_patience(connected: socket.socket, seconds: float) -> None:
    """Take the other side for gone when what was sent to it stays unacknowledged for so many seconds."""
    if connected.family != socket.AF_UNIX and hasattr(socket, "TCP_USER_TIMEOUT"):  # not everywhere
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, max(1, int(seconds * 1000)))


def _probe_when_silent(connected: socket.socket, seconds: int) -> None:
    """Have the system find out about a host that is gone without having closed its connections."""
    connected.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in (("TCP_KEEPIDLE", seconds), ("TCP_KEEPINTVL", seconds), ("TCP_KEEPCNT", _PROBES)):
        if hasattr(socket, name):  # not everywhere
            connected.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
