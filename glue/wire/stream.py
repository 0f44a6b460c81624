"""The messages of one connection: bytes in, messages out, and messages in, bytes out.

    stream = Stream(ROUTER, max_frame=2**20, max_body=2**20)
    stream.receive_data(data)
    while (event := stream.next_event()) is not None:
        ...                                  # a Message, or bytes to be sent at once
    head, body = stream.encode(message)

Nearly all messages of an experiment belong to steps. The formats of `glue.wire.steps` write and recognise
them as a whole; no other module needs to know. A stream learns both formats of a session's steps when it
writes the first message of a step there: at a hub a call, at a player an answer. What it has learned changes
nothing but its speed.
"""

from __future__ import annotations

from collections.abc import Sequence

from glue.errors import RemoteProtocolError
from glue.wire import zmtp
from glue.wire.codec import FROM_HUB, TO_HUB, UnknownKind, decode, encode
from glue.wire.messages import MAX_BODY, Kind, Message
from glue.wire.steps import STEPS, StepFormat, StepReader, lead_of, step_formats


class Malformed(RemoteProtocolError):
    """The frames received are not a message; later frames may be valid."""


class Stream:
    """Both directions of one connection.

    Args:
        own: this end of the connection, `zmtp.ROUTER` for the hub or `zmtp.DEALER` for a peer.
        max_frame: maximum size of a frame, in bytes.
        max_body: maximum size of a body, in bytes; may be set later.
        mechanism: encryption; None for none.

    Attributes:
        max_body: as given.
        empty: whether nothing is buffered, as all bytes received were part of messages.
    """

    __slots__ = (
        "_at",
        "_at_hub",
        "_data",
        "_decoder",
        "_incoming",
        "_leads",
        "_mechanism",
        "_only",
        "_outgoing",
        "_read",
        "_written",
        "empty",
        "max_body",
    )

    def __init__(
        self, own: bytes, max_frame: int, max_body: int = MAX_BODY, mechanism: zmtp.Mechanism | None = None
    ) -> None:
        at_hub = own is zmtp.ROUTER
        self.max_body: int = max_body
        self.empty: bool = True
        self._incoming, self._outgoing = (TO_HUB, FROM_HUB) if at_hub else (FROM_HUB, TO_HUB)
        self._at_hub = at_hub
        self._mechanism = mechanism
        self._decoder = zmtp.Decoder(own, max_frame, mechanism)
        self._written: dict[str, StepFormat] = {}  # by session
        self._read: dict[bytes, StepReader] = {}  # by the lead of the format
        self._leads: dict[str, bytes] = {}  # of the formats in `_read`, by session
        self._only: StepReader | None = None  # if there is only one
        self._data = b""  # begins with a message, and is not in the decoder yet
        self._at = 0  # number of its bytes that have been read

    @property
    def ready(self) -> bool:
        """Whether the handshake is complete."""
        return self._decoder.ready

    @property
    def buffered(self) -> int:
        """Bytes received that are not part of a message returned by `next_event`."""
        return len(self._data) - self._at + self._decoder.buffered

    @property
    def kept(self) -> int:
        """Like `buffered`, with the bytes that were read and are in memory until the rest is."""
        return len(self._data) + self._decoder.kept

    def receive_data(self, data: bytes) -> None:
        """Add bytes received from the connection."""
        if self.empty and self._read:
            self._data = data
        else:
            self._decode_rest()
            self._decoder.receive_data(data)
        self.empty = False

    def next_event(self) -> Message | bytes | None:
        """Return the next message, or bytes (possibly none) to send at once; None if more data is needed.

        Raises:
            UnknownKind: a well-formed message has an unknown kind; later messages can be read.
            Malformed: frames are not a message; later frames can be read.
            RemoteProtocolError: the data is not ZMTP 3, not what the partner may send, or too large, and
                nothing after it can be read; see `zmtp.Decoder.next_event`.
        """
        if self.empty:
            return None
        data, at = self._data, self._at
        if data and self._mechanism is not None:
            opened = self._mechanism.open_message(data)
            if opened is not None:
                self._data, self.empty = b"", True
                return self._decrypted(opened)
            self._decode_rest()
        elif data:
            reader = self._only or self._read.get(lead_of(data, at))
            message = None if reader is None else reader.read(data, at, self.max_body)
            if reader is not None and message is not None:
                at = reader.end
                if at == len(data):
                    self._data, self._at = b"", 0
                    self.empty = True
                else:
                    self._at = at
                return message
            self._decode_rest()
        event = self._decoder.next_event()
        if self._read and event is not None:
            self._data = self._decoder.take_back()
        self.empty = not self._data and not self._decoder.buffered
        if not isinstance(event, list):
            return event
        return self._decoded(event) if self._mechanism is None else self._decrypted(event)

    def _decoded(self, frames: Sequence[bytes]) -> Message:
        try:
            return decode(frames, self._incoming, self.max_body)
        except UnknownKind:
            raise
        except RemoteProtocolError as error:
            raise Malformed(str(error)) from None

    def _decrypted(self, frames: Sequence[bytes]) -> Message:
        """Return the message in decrypted frames."""
        reader = self._only or self._read.get(lead_of(frames[0], -zmtp.SHORT_HEAD.size))
        if reader is None or len(frames) != 2:
            return self._decoded(frames)
        message = reader.read_frames(frames[0], frames[1], self.max_body)
        if message is None:
            message = self._decoded(frames)
            reader.learn(message, frames[0])
        return message

    def _decode_rest(self) -> None:
        """Pass the bytes that are not a usual step to the decoder."""
        if self._data:
            self._decoder.receive_data(self._data[self._at :])
            self._data, self._at = b"", 0

    @property
    def copies(self) -> bool:
        """Whether `encode` copies a body: it has to be encrypted."""
        return self._mechanism is not None

    def encode(self, message: Message) -> tuple[bytes | bytearray, bytes]:
        """Return the bytes of a message in two parts, so that a large body need not be copied.

        Encrypted, the first part is all of it.

        Raises:
            LocalProtocolError: the header would be too long.
        """
        kind, session, seq, scalars, body = message
        form = self._written.get(session)
        if form is None or form.kind is not kind:
            form = self._learn(kind, session) if kind in STEPS else None
        if form is not None and seq <= StepFormat.max_seq and len(scalars) == form.num_scalars:
            head = form.head(seq, scalars, len(body))
            if self._mechanism is None:
                return head, body
            return self._mechanism.seal_message(head[2 : 2 + head[1]], body), b""
        frames = encode(message, self._outgoing)
        if self._mechanism is not None:
            return self._mechanism.encode(frames), b""
        return zmtp.encode_parts(frames)

    def forget(self, session: str) -> None:
        """Forget the formats of a session that this connection has left."""
        if self._written.pop(session, None) is not None:
            del self._read[self._leads.pop(session)]
            self._only = next(iter(self._read.values())) if len(self._read) == 1 else None

    def _learn(self, kind: Kind, session: str) -> StepFormat | None:
        """Remember the formats of a call and its answer; return the format that this end writes, if any."""
        formats = step_formats(kind, session)
        if formats is None:
            return None
        self.forget(session)
        written, read = formats if self._at_hub else reversed(formats)
        self._written[session] = written
        self._leads[session] = read.lead
        self._read[read.lead] = reader = StepReader(read)
        self._only = reader if len(self._read) == 1 else None
        return written
