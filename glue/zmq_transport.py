"""Frames over ZeroMQ: a ROUTER for the hub, a DEALER for each peer.

The only module that knows libzmq. A connection ends when the process at its other end does, or when what
was sent over it stays unacknowledged for too long, because a cable was cut: both are the kernel's to know,
so a peer that computes for hours stays connected. The heartbeats of ZMTP are not used: with a limit to what
is read ahead, libzmq 4.3.5 aborts the process when a connection breaks that it held back (its issues 3937
and 4364).
"""

from __future__ import annotations

import errno
import socket
from collections.abc import Sequence
from typing import Final

import zmq

from glue.errors import ConfigError

__all__ = ["Context", "DealerTransport", "RouterTransport"]

Context = zmq.Context[zmq.Socket[bytes]]

# As plain ints: on the hot path, pyzmq's flags cost more than what they say.
_NOBLOCK: Final = int(zmq.NOBLOCK)
_MORE: Final = int(zmq.SNDMORE)
_NOBLOCK_MORE: Final = _NOBLOCK | _MORE

_LINGER_MS: Final = 1000
"""How long a closing socket tries to deliver its last words, in milliseconds."""

_HUB_READS_AHEAD: Final = 64
"""Messages that the hub reads ahead from one peer; behind it, the network holds the sender back."""

_PEER_READS_AHEAD: Final = 0
"""No limit: the hub's signs of life pile up while a player computes."""

_SEND_QUEUE: Final = 4096
"""Messages that wait for one peer: a call for each session that it serves, and heartbeats."""


def _prepare(made: zmq.Socket[bytes], patience: float, max_frame: int, ahead: int) -> None:
    made.setsockopt(zmq.LINGER, _LINGER_MS)
    made.setsockopt(zmq.SNDHWM, _SEND_QUEUE)
    made.setsockopt(zmq.RCVHWM, ahead)
    made.setsockopt(zmq.MAXMSGSIZE, max_frame)
    made.setsockopt(zmq.TCP_MAXRT, max(1, int(patience * 1000)))


class RouterTransport:
    """The hub's end. A route is the routing id that the ROUTER gives to a connection: new with each one.

    Raises:
        ConfigError: an address is taken or cannot be bound.
    """

    def __init__(self, context: Context, bind: Sequence[str], patience: float, max_frame: int) -> None:
        self.socket = context.socket(zmq.ROUTER)
        _prepare(self.socket, patience, max_frame, _HUB_READS_AHEAD)
        # Without it a message for a route that is gone would vanish silently.
        self.socket.setsockopt(zmq.ROUTER_MANDATORY, 1)
        self.endpoints: list[str] = []
        for url in bind:
            try:
                self.socket.setsockopt(zmq.IPV6, "[" in url)
                _check_path_is_free(url)
                self.socket.bind(url)
            except zmq.ZMQError as error:
                self.socket.close(0)
                raise ConfigError(_bind_error(url, error)) from None
            self.endpoints.append(self.socket.getsockopt_string(zmq.LAST_ENDPOINT))

    def send(self, route: bytes, frames: Sequence[bytes]) -> bool:
        """Send a message; return False, having sent nothing, if the route is gone or does not read."""
        send = self.socket.send
        try:
            send(route, _NOBLOCK_MORE)
            for frame in frames[:-1]:
                send(frame, _NOBLOCK_MORE)
            send(frames[-1], _NOBLOCK)
        except zmq.ZMQError as error:
            if error.errno in (errno.EHOSTUNREACH, errno.EAGAIN):
                return False
            raise
        return True

    def receive(self) -> tuple[bytes, list[bytes]]:
        """Return the next message, which must be there, and the route it came by.

        No more than three frames are kept: that is one too many, which is all that need be known.
        """
        recv = self.socket.recv
        route = recv(_NOBLOCK)
        frame = recv(_NOBLOCK, False)  # behind its route, a message has one frame at least
        frames = [frame.bytes]
        while frame.more:
            frame = recv(_NOBLOCK, False)
            if len(frames) < 3:
                frames.append(frame.bytes)
        return route, frames

    def close(self) -> None:
        """Close, giving the last messages a moment to leave."""
        self.socket.close()


class DealerTransport:
    """A peer's end. It connects when the hub is there, and again whenever the connection breaks."""

    def __init__(self, context: Context, url: str, patience: float, max_frame: int) -> None:
        self.socket = context.socket(zmq.DEALER)
        _prepare(self.socket, patience, max_frame, _PEER_READS_AHEAD)
        self.socket.setsockopt(zmq.RECONNECT_IVL, 50)
        self.socket.setsockopt(zmq.RECONNECT_IVL_MAX, 1000)
        self.socket.setsockopt(zmq.CONNECT_TIMEOUT, max(1, int(patience * 1000)))
        self.socket.setsockopt(zmq.SNDTIMEO, 0)
        self.socket.setsockopt(zmq.IPV6, "[" in url)
        try:
            self.socket.connect(url)
        except zmq.ZMQError as error:
            self.socket.close(0)
            raise ConfigError(f"cannot connect to {url}: {error.strerror}") from None

    def wait_at_most(self, seconds: float) -> None:
        """Set how long `receive` waits."""
        self.socket.setsockopt(zmq.RCVTIMEO, max(1, int(seconds * 1000)))

    def send(self, frames: Sequence[bytes]) -> bool:
        """Queue a message; return False if the queue is full, as it is while there is no hub."""
        try:
            for frame in frames[:-1]:
                self.socket.send(frame, _MORE)
            self.socket.send(frames[-1], 0)
        except zmq.Again:
            return False
        return True

    def receive(self) -> list[bytes] | None:
        """Return the next message, or None if none came in time."""
        try:
            frame = self.socket.recv(0, False)
            frames = [frame.bytes]
            while frame.more:
                frame = self.socket.recv(0, False)
                frames.append(frame.bytes)
            return frames
        except zmq.Again:
            return None

    def close(self, linger: float | None = None) -> None:
        """Close, giving the last messages at most `linger` seconds (by default one) to leave."""
        self.socket.close(_LINGER_MS if linger is None else int(linger * 1000))


def _check_path_is_free(url: str) -> None:
    """Raise EADDRINUSE if somebody listens on an ipc path: libzmq would take it over without a word."""
    scheme, _, path = url.partition("://")
    if scheme != "ipc":
        return
    with socket.socket(socket.AF_UNIX) as probe:
        if probe.connect_ex("\0" + path[1:] if path.startswith("@") else path) == 0:
            raise zmq.ZMQError(errno.EADDRINUSE)


def _bind_error(url: str, error: zmq.ZMQError) -> str:
    if error.errno == errno.EADDRINUSE:
        return (
            f"{url} is in use: is another hub or experiment running there? "
            f"Stop it, or choose another address with --bind"
        )
    if error.errno == errno.EADDRNOTAVAIL or error.errno == errno.ENODEV:
        return f"{url} is not an address of this machine"
    return f"cannot listen on {url}: {error.strerror}"
