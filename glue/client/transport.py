"""A peer's end of ZeroMQ: a DEALER.

The only module that knows libzmq. A connection ends when the process at its other end does, or when what
was sent over it stays unacknowledged for too long, because a cable was cut: both are the kernel's to know,
so a peer that computes for hours stays connected.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

import zmq

from glue.errors import ConfigError

__all__ = ["Context", "DealerTransport"]

Context = zmq.Context[zmq.Socket[bytes]]

# As a plain int: on the hot path, pyzmq's flags cost more than what they say.
_MORE: Final = int(zmq.SNDMORE)

_LINGER_MS: Final = 1000
"""How long a closing socket tries to deliver its last words, in milliseconds."""


class DealerTransport:
    """A peer's end. It connects when the hub is there, and again whenever the connection breaks."""

    def __init__(self, context: Context, url: str, patience: float, max_frame: int) -> None:
        self.socket = context.socket(zmq.DEALER)
        milliseconds = max(1, int(patience * 1000))
        for option, value in {
            zmq.LINGER: _LINGER_MS,
            zmq.SNDHWM: 4096,
            # No limit: the hub's signs of life pile up while a player computes.
            zmq.RCVHWM: 0,
            zmq.MAXMSGSIZE: max_frame,
            zmq.TCP_MAXRT: milliseconds,
            zmq.CONNECT_TIMEOUT: milliseconds,
            zmq.RECONNECT_IVL: 50,
            zmq.RECONNECT_IVL_MAX: 1000,
            zmq.SNDTIMEO: 0,
            zmq.IPV6: int("[" in url),
        }.items():
            self.socket.setsockopt(option, value)
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
