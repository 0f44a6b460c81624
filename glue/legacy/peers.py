"""Original programs as peers and players: translation between frames of their protocol and messages.

`glue.legacy.gateway` explains the rules for original programs and their reasons; `glue.legacy.states` has the
states.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

from glue.doors import chance, clock
from glue.errors import LocalProtocolError, RemoteProtocolError
from glue.hub.config import LegacyPort
from glue.hub.io.connection import Connection
from glue.hub.sessions import INSTANCE_SIZE, ONE_RUN
from glue.legacy.codec import (
    TO_AGENT,
    TO_ENVIRONMENT,
    Decoder,
    Frame,
    Vocabulary,
    encode,
)
from glue.legacy.pending import Pending
from glue.legacy.states import (
    PLAYER,
    PlayerEvent,
    PlayerState,
    after,
)
from glue.wire.messages import CALLS, PROTOCOL_VERSION, ErrorCode, Kind, Message, Role

_BASE: Final = 8192
"""Bytes that a program's connection and its seat use at most besides what it has received and not sent."""

_CODEC: Final = "RL-Glue 3.x"

_TO_PLAYER: Final[Mapping[Role, Vocabulary]] = {Role.AGENT: TO_AGENT, Role.ENVIRONMENT: TO_ENVIRONMENT}


class LegacyPeer:
    """An original program in its role; a route of the switchboard."""

    def __init__(
        self, pending: Pending, connection: Connection, decoder: Decoder, role: Role, port: LegacyPort
    ) -> None:
        self._pending = pending
        self._connection = connection
        self._decoder = decoder
        self._role = role
        self._session = port.session
        self._port = port
        self._held = 0
        connection.owner = self
        connection.in_turn = True
        pending.on_tick(self._weigh)

    def join(self, now: float) -> None:
        """Ask the switchboard for the role."""
        capabilities = () if self._role is Role.EXPERIMENT else (ONE_RUN,)
        instance = chance.random_bytes(INSTANCE_SIZE)
        # Its protocol declares no name. Its address differs in each trial, so it must not name it in results.
        name, codec = f"original {self._role}", f"{_CODEC} at {self._connection.name}"
        scalars = ((PROTOCOL_VERSION,), str(self._role), instance, name, codec, capabilities)
        self._send(Message(Kind.HELLO, self._session, 0, scalars), now)
        if self._decoder.buffered:
            self._connection.later()

    def deliver(self, message: Message) -> bool:
        """Accept a message from the switchboard; return False if the program is gone."""
        connection = self._connection
        if connection.closed:
            return False
        try:
            delivered = self._take(message)
        except Exception:
            # An error of this program's connection must not interrupt another program.
            connection.fail()
            return False
        self._weigh()
        return delivered

    def _take(self, message: Message) -> bool:
        """Handle a message from the switchboard; return False if the program is gone."""
        raise NotImplementedError

    def admits(self, role: Role, session: str) -> bool:
        """Return whether `role` of `session` can be taken at this port."""
        return role in self._port.roles and session == self._port.session

    @property
    def seated(self) -> bool:
        """Whether it takes part in a session."""
        return self._pending.hub.switchboard.num_seats(self) > 0

    def evict(self, why: str) -> None:
        """Drop the connection, which uses too much memory."""
        self._connection.reset()
        self._pending.hub.switchboard.lose(self, f"was dropped: {why}", clock.monotonic())

    def failed(self, now: float) -> None:
        """Leave the session: the connection was reset after an error of the hub."""
        self._pending.hub.switchboard.lose(self, "was dropped after an error of the hub", now)

    def _weigh(self) -> bool:
        """Account for data not handled yet or not sent; return False once the connection has closed."""
        connection = self._connection
        held = 0
        if not connection.closed:
            held = _BASE + self._decoder.buffered + connection.unsent + self._kept()
        if held != self._held:
            self._held = held
            self._pending.hub.switchboard.memory.hold(self, held)
        return not connection.closed

    def _kept(self) -> int:
        """Return the number of bytes in messages that are kept here."""
        return 0

    def ready(self, now: float) -> None:
        """Handle received data, and account for its memory."""
        self._work(now)
        self._weigh()
        self._pending.hub.switchboard.memory.relieve()

    def _work(self, now: float) -> None:
        """Receive and handle data."""
        raise NotImplementedError

    def _next_frame(self) -> Frame | None:
        """Return the next frame, or None until more bytes are received.

        Raises:
            RemoteProtocolError: the frame is malformed, not one of this role, or too long for this hub.
        """
        frame = self._decoder.next_event()
        limit = self._pending.hub.config.max_body
        if frame is not None and len(frame.body) > limit:
            raise RemoteProtocolError(
                f"{frame.kind.name} has a body of {len(frame.body)} bytes; this hub takes {limit}"
            )
        return frame

    def _send(self, message: Message, now: float) -> None:
        self._pending.hub.switchboard.receive(self, message, now)


class LegacyPlayer(LegacyPeer):
    """An agent or environment, which answers calls."""

    _state = PlayerState.IDLE

    _call: Message | None = None
    """The call that the player was sent last."""

    _next: Message | None = None
    """The call to send after its answer."""

    _substitute: Message | None = None
    """The answer to a call that is not sent, since it cannot be written in the player's format."""

    def _take(self, message: Message) -> bool:
        if self._state is PlayerState.GONE:
            return False
        if message.kind in CALLS:
            repeated = self._state is PlayerState.BUSY and self._call and message.seq == self._call.seq
            if not repeated:
                self._on(PlayerEvent.CALL)
                if self._state is PlayerState.BUSY:
                    self._ask(message)
                else:
                    self._next = message
        elif message.kind is Kind.GOODBYE or message.kind is Kind.REFUSE:
            self._dismiss()
        return not self._connection.closed

    def _on(self, event: PlayerEvent) -> None:
        self._state = after(PLAYER, self._state, event)

    def _dismiss(self) -> None:
        self._on(PlayerEvent.DISMISSED)
        if self._state is PlayerState.LEAVING:
            # The player may never answer.
            self._pending.add(self._connection, self._time_out, closing=True)
        else:
            self._pending.terminate(self._connection)

    def _time_out(self, now: float) -> None:
        self._on(PlayerEvent.LOST)
        self._pending.terminate(self._connection)

    def _ask(self, call: Message) -> None:
        self._call = call._replace(body=b"")  # the session keeps it as long as it is needed
        try:
            frame = encode(Frame(call.kind, call.scalars, call.body), _TO_PLAYER[self._role])
        except LocalProtocolError as error:
            scalars = (str(ErrorCode.EXCEPTION), str(error))
            self._substitute = Message(Kind.ERROR, self._session, call.seq, scalars)
            self._connection.later()
        else:
            self._connection.send(frame)
            self._pending.hub.loop.expect(self._connection)

    def _work(self, now: float) -> None:
        connection, switchboard = self._connection, self._pending.hub.switchboard
        if self._substitute is not None:
            substitute, self._substitute = self._substitute, None
            self._finish_call(substitute, now)
        data = connection.receive()
        if data:
            self._decoder.receive_data(data)
        try:
            while self._state is not PlayerState.GONE and (frame := self._next_frame()) is not None:
                self._finish_call(self._answer(frame), now)
        except RemoteProtocolError as error:
            self._on(PlayerEvent.LOST)
            switchboard.malformed(self, error, now)
            self._pending.terminate(connection)
            return
        if data == b"" and self._state is not PlayerState.GONE:
            self._on(PlayerEvent.LOST)
            connection.close()
            switchboard.lose(self, "closed its connection", now)

    def _answer(self, frame: Frame) -> Message:
        """Return `frame` as the answer to the call.

        Raises:
            RemoteProtocolError: `frame` does not answer the call.
        """
        call = self._call
        if call is None or self._substitute or PlayerEvent.ANSWER not in PLAYER[self._state]:
            raise RemoteProtocolError(f"received {frame.kind.name}; nothing was asked")
        if frame.kind is not call.kind:
            raise RemoteProtocolError(f"received {frame.kind.name}; {call.kind.name} was asked")
        return Message(call.kind, self._session, call.seq, frame.scalars, frame.body)

    def _finish_call(self, answer: Message, now: float) -> None:
        self._on(PlayerEvent.ANSWER)
        match self._state:
            case PlayerState.IDLE:
                self._send(answer, now)
            case PlayerState.BUSY:
                assert self._next is not None
                self._ask(self._next)
            case PlayerState.GONE:
                self._pending.terminate(self._connection)
