"""Original programs as peers, and as players: between the frames of their protocol and the hub's messages.

The two sides' rules about each other, and why original clients need them, are in `glue.legacy.gateway`; those
about states in `glue.legacy.states`.
"""

from __future__ import annotations

import os
import time
from collections.abc import Mapping
from typing import Final

from glue.core.config import LegacyPort
from glue.core.sessions import INSTANCE_SIZE, ONE_RUN
from glue.errors import LocalProtocolError, RemoteProtocolError
from glue.hub.connection import Connection
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
from glue.protocol.messages import CALLS, PROTOCOL_VERSION, ErrorCode, Kind, Message, Role

__all__ = ["Peer", "Player"]

_CODEC: Final = "RL-Glue 3.x"

_TO_PLAYER: Final[Mapping[Role, Vocabulary]] = {Role.AGENT: TO_AGENT, Role.ENVIRONMENT: TO_ENVIRONMENT}


class Peer:
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
        connection.ready = self._ready
        connection.failed = self._failed
        connection.in_turn = True
        pending.on_tick(self._weigh)

    def join(self, now: float) -> None:
        """Ask the switchboard for the role."""
        capabilities = () if self._role is Role.EXPERIMENT else (ONE_RUN,)
        instance = os.urandom(INSTANCE_SIZE)
        name = self._connection.name
        scalars = ((PROTOCOL_VERSION,), str(self._role), instance, name, _CODEC, capabilities)
        self._send(Message(Kind.HELLO, self._session, 0, scalars), now)
        if self._decoder.buffered:
            self._connection.later()

    def deliver(self, message: Message) -> bool:
        """Take a message from the switchboard; return False if the program is gone."""
        connection = self._connection
        if connection.closed:
            return False
        try:
            delivered = self._take(message)
        except Exception:
            # An error about this program must not end what another one is doing.
            connection.fail()
            return False
        self._weigh()
        return delivered

    def _take(self, message: Message) -> bool:
        """Act on a message from the switchboard; return False if the program is gone."""
        raise NotImplementedError

    def admits(self, role: Role, session: str) -> bool:
        """Return whether `role` of `session` can be taken from here."""
        return role in self._port.roles and session == self._port.session

    @property
    def seated(self) -> bool:
        """Whether it takes part in a session."""
        return self._pending.hub.switchboard.num_seats(self) > 0

    def evict(self, why: str) -> None:
        """Drop the connection: it uses too much memory."""
        self._connection.reset()
        self._pending.hub.switchboard.lose(self, f"was dropped: {why}", time.monotonic())

    def _failed(self, now: float) -> None:
        self._pending.hub.switchboard.lose(self, "was dropped after an error of the hub", now)

    def _weigh(self) -> bool:
        """Account for data not acted on yet and not sent; return False once the connection has closed."""
        connection = self._connection
        held = 0 if connection.closed else self._decoder.buffered + connection.unsent
        if held != self._held:
            self._held = held
            self._pending.hub.switchboard.memory.hold(self, held)
        return not connection.closed

    def _ready(self, now: float) -> None:
        self._work(now)
        self._weigh()
        self._pending.hub.switchboard.memory.relieve()

    def _work(self, now: float) -> None:
        """Receive, and act on what was received."""
        raise NotImplementedError

    def _next_frame(self) -> Frame | None:
        """Return the next frame, or None until more bytes are received.

        Raises:
            RemoteProtocolError: it is malformed, not one of this role, or too long for this hub.
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


class Player(Peer):
    """An agent or environment, which answers calls."""

    _state = PlayerState.IDLE

    _call: Message | None = None
    """The call that it was sent."""

    _next: Message | None = None
    """The call to send when it has answered."""

    _substitute: Message | None = None
    """What answers in its stead a call that cannot be written in its format."""

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
            # It may never answer.
            self._pending.add(self._connection, self._time_out, closing=True)
        else:
            self._pending.terminate(self._connection)

    def _time_out(self, now: float) -> None:
        self._on(PlayerEvent.LOST)
        self._pending.terminate(self._connection)

    def _ask(self, call: Message) -> None:
        self._call = call
        try:
            frame = encode(Frame(call.kind, call.scalars, call.body), _TO_PLAYER[self._role])
        except LocalProtocolError as error:
            scalars = (str(ErrorCode.EXCEPTION), str(error))
            self._substitute = Message(Kind.ERROR, self._session, call.seq, scalars)
            self._connection.later()
        else:
            self._connection.send(frame)
            self._pending.hub.loop.expect()

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
        """Return the answer that `frame` is to the call.

        Raises:
            RemoteProtocolError: it is not an answer to it.
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
