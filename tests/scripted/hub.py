"""A hub that sends only the messages of a test, on libzmq's ROUTER: a foreign implementation of the wire."""

from __future__ import annotations

from typing import Final

import zmq

from glue.client.libzmq import Context
from glue.wire.codec import FROM_HUB, TO_HUB, decode, encode
from glue.wire.messages import Message

_TIMEOUT: Final = 30.0


class ScriptedHub:
    """A hub that answers the peer of the latest message.

    Args:
        url: address to listen at, of scheme `tcp` or `ipc`; `*` for any port.

    Attributes:
        url: address to connect to.
        route: identity of the connection over which the latest message came.
    """

    def __init__(self, url: str = "tcp://127.0.0.1:*") -> None:
        self._context: Context = zmq.Context()
        self._socket = self._context.socket(zmq.ROUTER)
        self._socket.setsockopt(zmq.RCVTIMEO, int(_TIMEOUT * 1000))
        self._socket.setsockopt(zmq.LINGER, 0)
        self._socket.setsockopt(zmq.ROUTER_MANDATORY, 1)
        self._socket.bind(url)
        self.url = self._socket.getsockopt_string(zmq.LAST_ENDPOINT)
        self.route = b""

    def __enter__(self) -> ScriptedHub:
        return self

    def __exit__(self, *_: object) -> None:
        """End every connection without a goodbye, and free everything."""
        self._socket.close()
        self._context.term()

    # Frames

    def receive_frames(self) -> list[bytes]:
        """Return the frames of the next message."""
        self.route, *frames = self._socket.recv_multipart()
        return frames

    def send_frames(self, *frames: bytes) -> None:
        """Send any frames."""
        self._socket.send_multipart([self.route, *frames])

    # Messages

    def send(self, *messages: Message) -> None:
        """Send messages."""
        for message in messages:
            self.send_frames(*encode(message, FROM_HUB))

    def next(self) -> Message:
        """Return the next message, of whatever kind."""
        return decode(self.receive_frames(), TO_HUB)
