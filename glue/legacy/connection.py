"""A TCP connection in the hub's loop: it never waits, and keeps only what it was given to send."""

from __future__ import annotations

import socket
import struct
from collections.abc import Callable
from contextlib import suppress
from typing import Final

import zmq

from glue.hub import Hub

__all__ = ["Connection"]

_CHUNK: Final = 65_536
"""The most bytes that are read at once; beyond it, memory for a short message would cost a system call."""

_PROBES: Final = 3
"""Unanswered probes, one a heartbeat, after which a host that fell silent is taken for gone."""

_AT_ONCE: Final = struct.pack("ii", 1, 0)
"""SO_LINGER: what is unsent is dropped, and the other side sees a reset."""


class Connection:
    """A connected socket.

    Args:
        hub: whose loop it joins.
        connected: the socket; it is closed by `close` or `reset`.
        name: the other side's address, for people.

    Attributes:
        ready: called with the time when something has come, when all has been sent, and after `later`.
        closed: nothing can be sent or received any more.
    """

    def __init__(self, hub: Hub, connected: socket.socket, name: str) -> None:
        connected.setblocking(False)
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        _probe_when_silent(connected, max(1, round(hub.config.heartbeat)))
        self.name = name
        self.ready: Callable[[float], None] = lambda now: None
        self.closed = False
        self._hub = hub
        self._socket = connected
        self._unsent = bytearray()
        self._reading = True
        self._later = False
        self._finishing = False
        self._gone = False
        self._watched = 0
        self._watch()

    def fileno(self) -> int:
        """Return the socket's descriptor."""
        return self._socket.fileno()

    @property
    def events(self) -> int:
        """What there is to wait for: zmq.POLLIN, POLLOUT and POLLERR."""
        # Errors always: a poller forgets what is watched for nothing.
        events = int(zmq.POLLERR)
        if self._reading:
            events |= zmq.POLLIN
        if self._unsent or self._later:
            events |= zmq.POLLOUT
        return events

    @property
    def sending(self) -> bool:
        """Whether something sent is still here, since the other side does not read."""
        return bool(self._unsent)

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
        if self._gone:
            return b""
        if not self._reading:
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
            data = data[self._write(data) :]
        if data:
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
            self._hub.unwatch(self._socket.fileno())
            self._socket.close()

    def reset(self) -> None:
        """Close so that the other side's next call fails, whatever it was going to do."""
        if not self.closed:
            self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, _AT_ONCE)
            self.close()

    def turn(self, now: float) -> None:
        """Send what is left, and call `ready`: something has happened, or `later` was called."""
        self._later = False
        if self._unsent:
            del self._unsent[: self._write(self._unsent)]
            if self._finishing:
                self._end_if_sent()
        if not self._reading and self._socket.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR):
            self._gone = True
        self._watch()
        self.ready(now)

    def _write(self, data: bytes | bytearray) -> int:
        try:
            return self._socket.send(data)
        except BlockingIOError:
            return 0
        except OSError:
            self._gone = True
            self.later()
            return len(data)

    def _watch(self) -> None:
        events = self.events
        if events != self._watched and not self.closed:
            self._watched = events
            self._hub.watch(self._socket.fileno(), events, self.turn)

    def _end_if_sent(self) -> None:
        if not self._unsent:
            with suppress(OSError):  # the other side may be gone
                self._socket.shutdown(socket.SHUT_WR)

    def _discard(self, now: float) -> None:
        if self.receive() == b"":
            self.close()


def _probe_when_silent(connected: socket.socket, seconds: int) -> None:
    """Have the system find out about a host that is gone without having closed its connections."""
    connected.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in (("TCP_KEEPIDLE", seconds), ("TCP_KEEPINTVL", seconds), ("TCP_KEEPCNT", _PROBES)):
        if hasattr(socket, name):  # not everywhere
            connected.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)
