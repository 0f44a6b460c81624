"""What connections that carry frames have in common: what is sent is encoded, what is received is checked."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence

from glue.protocol.messages import Message
from glue.protocol.wire import FROM_HUB, TO_HUB, decode, encode

__all__ = ["FrameTransport"]


class FrameTransport(ABC):
    """A transport whose other end is in another process."""

    @abstractmethod
    def send(self, frames: Sequence[bytes]) -> bool:
        """Send a message; return False, having sent nothing, if there is no connection or no room."""

    @abstractmethod
    def receive(self) -> Sequence[bytes] | None:
        """Return the next message; None if none arrived in time, or as soon as there is a connection."""

    def send_message(self, message: Message) -> bool:
        """Send a message; as `send`."""
        return self.send(encode(message, TO_HUB))

    def receive_message(self, max_body: int) -> Message | None:
        """Return the next message; as `receive`.

        Raises:
            UnknownKind: it is of a kind that is not known here.
            RemoteProtocolError: it is malformed, or its body has more than `max_body` bytes.
        """
        frames = self.receive()
        return None if frames is None else decode(frames, FROM_HUB, max_body)
