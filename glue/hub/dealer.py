"""One connection at the hub, and the peer at its other end."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from glue.core.config import Bind
from glue.core.keys import Keys
from glue.errors import RemoteProtocolError
from glue.hub.connection import Connection
from glue.protocol import zmtp
from glue.protocol.messages import OBSERVING, Kind, Message, Role
from glue.protocol.steps import MAX_LEAD, StepFormat, lead_of, step_formats
from glue.protocol.wire import FROM_HUB, MAX_HEADER, encode

if TYPE_CHECKING:
    from glue.hub.router import Router

__all__ = ["MAX_UNSENT", "Dealer", "KeyedDealer"]

MAX_UNSENT: Final = 64 * 2**20
"""Maximum number of bytes waiting to be sent to one peer; with more it is unreachable: it does not read."""

_STEPS: Final = frozenset({Kind.ENV_STEP, Kind.AGENT_STEP})

_MAX_EXPECTED: Final = 4096
"""Maximum number of steps whose answers a connection recognises by their bytes; any others are decoded."""


class Dealer:
    """One connection, and the peer at its other end; a route of the switchboard.

    Attributes:
        connection: as it is.
    """

    def __init__(self, router: Router, connection: Connection, bind: Bind, max_body: int) -> None:
        self.connection = connection
        self.admits = bind.admits
        self._router = router
        self._max_body = max_body
        # What is only a little too long is read, and answered with an error that says so.
        self._decoder = zmtp.Decoder(zmtp.ROUTER, max_body + MAX_HEADER)
        self._expected: dict[bytes, StepFormat] = {}  # by their lead, the formats of answers to steps sent
        self._held = 0
        self._dismissed = False
        connection.ready = self._ready
        connection.failed = self._failed

    def deliver(self, message: Message) -> bool:
        """Pass `message` on; return False, having sent nothing, if the peer is gone or does not read."""
        connection = self.connection
        if connection.closed or self._dismissed or connection.unsent > MAX_UNSENT:
            return False
        kind, session, seq, scalars, body = message
        if kind in _STEPS and seq <= StepFormat.max_seq:
            request, reply = step_formats(kind, session)
            if len(self._expected) > _MAX_EXPECTED:
                self._expected.clear()
            self._expected[reply.lead] = reply
            joined = self._router.joined
            if joined is not None:
                joined.setdefault(self, []).append(request.encode(seq, scalars, body))
                return True
            connection.send(request.encode(seq, scalars, body))
            self._router.expect()
        elif kind in OBSERVING and connection.unsent:
            return False  # an observer that has not read the previous messages misses this one
        else:
            self.send_joined()
            connection.send(zmtp.encode(encode(message, FROM_HUB)))
        if connection.unsent:
            self._weigh()
        return True

    def send_joined(self) -> None:
        """Send the steps that were joined for this peer, if there are any."""
        joined = self._router.joined
        steps = joined.pop(self, None) if joined else None
        if steps is not None and not self.connection.closed:
            self.connection.send(b"".join(steps))
            self._router.expect()
            if self.connection.unsent:
                self._weigh()

    @property
    def seated(self) -> bool:
        """Whether it takes part in a session."""
        return self._router.num_seats(self) > 0

    def evict(self, why: str) -> None:
        """Drop the connection: it uses too much memory."""
        self._router.drop(self, why)

    def _weigh(self) -> None:
        """Account for what is kept: messages that are not complete, and what the peer has not read."""
        held = self._decoder.buffered + self.connection.unsent
        if held != self._held and not self.connection.closed:
            self._held = held
            self._router.memory.hold(self, held)

    def _ready(self, now: float) -> None:
        data = self.connection.receive()
        if data:
            if self._expected:
                data = self._answer_steps(data, now)
                if not data:
                    return
            self._decoder.receive_data(data)
        try:
            done = self._work(now)
        except RemoteProtocolError as error:
            if isinstance(error, zmtp.HandshakeRefused):
                self.connection.send(error.farewell)
            self._dismiss(str(error))
            return
        if data == b"" and done:
            self._router.drop(self, None)
        else:
            self._weigh()
        self._router.memory.relieve()

    def _answer_steps(self, data: bytes, now: float) -> bytes:
        """Act on the messages that `data` begins with if they answer outstanding steps; return what is left.

        There are at most as many as seats: each of them is the answer to a step of another session. The steps
        that follow from them leave together, in one system call for each peer: sent one by one, the first
        would wake a peer that finds but one of them to answer.
        """
        if len(data) > self._max_body or not self._decoder.between_messages:
            return data
        if len(self._expected) == 1:
            return self._answer_each(data, now)
        joined = self._router.joined = {}
        try:
            return self._answer_each(data, now)
        finally:
            for dealer in list(joined):
                dealer.send_joined()
            self._router.joined = None

    def _answer_each(self, data: bytes, now: float) -> bytes:
        connection, expected = self.connection, self._expected
        at = 0
        while at < len(data) and not connection.unsent:
            form = expected.get(lead_of(data, at))
            found = None if form is None else form.decode(data, at)
            if form is None or found is None:
                break
            del expected[form.lead]
            if not self._router.receive_step(self, form, found[0], now):
                break
            at = found[1]
            connection.in_turn = True
        return data[at:]

    def _work(self, now: float) -> bool:
        """Act on messages received, one for each seat; return whether more must arrive first."""
        connection, decoder, router = self.connection, self._decoder, self._router
        seats = router.num_seats(self)
        for _ in range(seats or 1):
            if connection.unsent:
                # The turn after everything was sent comes back to this.
                connection.read(False)
                return False
            event = decoder.next_event()
            if event is None:
                connection.read(True)
                return True
            if isinstance(event, bytes):
                connection.in_turn = False
                connection.send(event)
            else:
                connection.in_turn = router.receive(self, event, now)
                if not seats and router.num_seats(self):
                    router.seated(self)
            if not connection.in_turn:
                break
            if self._expected and lead_of(decoder.peek(MAX_LEAD), 0) in self._expected:
                decoder.receive_data(self._answer_steps(decoder.take_back(), now))
        if not decoder.buffered:
            connection.read(True)
            return True
        connection.read(False)
        connection.later()
        return False

    def _dismiss(self, why: str) -> None:
        """End the connection, once what it was sent has arrived; from now on it is sent nothing."""
        self._dismissed = True
        self._decoder = zmtp.Decoder(zmtp.ROUTER, 0)
        self._weigh()
        self._router.complain(self, why)
        self.connection.in_turn = False
        self.connection.finish()

    def _failed(self, now: float) -> None:
        self._router.drop(self, None)
        self._router.lose(self, "was dropped after an error of the hub", now)


class KeyedDealer(Dealer):
    """A connection at an address with keys: it speaks CURVE, and may join what key and address open."""

    def __init__(self, router: Router, connection: Connection, bind: Bind, max_body: int, keys: Keys) -> None:
        from glue.protocol.curve import CurveServer  # needs an extra

        super().__init__(router, connection, bind, max_body)
        self._bind = bind
        self._keys = keys
        self._curve = CurveServer(keys.secret, lambda client: client in self._keys.permits)
        self._decoder = zmtp.Decoder(zmtp.ROUTER, max_body + MAX_HEADER, self._curve)
        self.admits = self._admits

    def deliver(self, message: Message) -> bool:
        """As of every dealer; but no step has a quick form here."""
        connection = self.connection
        if connection.closed or self._dismissed or connection.unsent > MAX_UNSENT:
            return False
        if message.kind in OBSERVING and connection.unsent:
            return False
        connection.send(self._curve.encode(encode(message, FROM_HUB)))
        if message.kind in _STEPS:
            self._router.expect()
        if connection.unsent:
            self._weigh()
        return True

    def renew(self, keys: Keys) -> str | None:
        """Take the hub's new keys; return why the connection has to end, if it has to."""
        before, self._keys = self._keys, keys
        client = self._curve.client
        if keys.secret != before.secret:
            return "the hub has a new key"
        if not client or keys.permits.get(client) == before.permits[client]:
            return None
        name = before.permits[client].name
        return f"the key of {name!r} was {'changed' if client in keys.permits else 'removed'}"

    def _admits(self, role: Role, session: str) -> bool:
        return self._bind.admits(role, session) and self._keys.permits[self._curve.client].admits(
            role, session
        )
