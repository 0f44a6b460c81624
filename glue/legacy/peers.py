"""Original programs as peers and players: translation between frames of their protocol and messages.

`glue.legacy.gateway` explains the rules for original programs and their reasons; `glue.legacy.states` has the
states.
"""

from __future__ import annotations

from typing import Final

from glue.errors import LocalProtocolError, RemoteProtocolError
from glue.hub.config import LegacyPort
from glue.hub.io.connection import Connection, Owner
from glue.hub.sessions import INSTANCE_SIZE, ONE_RUN
from glue.legacy.codec import HEAD_SIZE, TO, Decoder, Frame, encode
from glue.legacy.pending import Pending
from glue.legacy.states import PLAYER, PlayerEvent, PlayerState
from glue.system import chance, clock
from glue.wire.messages import CALLS, PROTOCOL_VERSION, ErrorCode, Kind, Message, Role

BASE: Final = 8192
"""Bytes that a program's connection and its peer use at most besides what it has received and not sent."""

_CODEC: Final = "RL-Glue 3.x"

# Bound once: looking up a member of an enum takes longer than comparing with it.
_IDLE: Final = PlayerState.IDLE
_BUSY: Final = PlayerState.BUSY
_GONE: Final = PlayerState.GONE
_CALL: Final = PlayerEvent.CALL
_ANSWER: Final = PlayerEvent.ANSWER
_CALLED: Final = PLAYER[_IDLE][_CALL]
_STEPS: Final = frozenset((Kind.ENV_STEP, Kind.AGENT_STEP))
_ANSWERED: Final = PLAYER[_BUSY][_ANSWER]

_message: Final = tuple.__new__
"""Constructor of a named tuple, at half the cost of calling its class."""


class LegacyPeer(Owner):
    """An original program in its role; a channel of the sessions."""

    def __init__(
        self, pending: Pending, connection: Connection, decoder: Decoder, role: Role, port: LegacyPort
    ) -> None:
        self._pending = pending
        self._sessions = pending.hub.sessions
        self._loop = pending.hub.loop
        self._connection = connection
        self._decoder = decoder
        self._role = role
        self._vocabulary = TO[role]
        self._session = port.session
        self._port = port
        self._held = 0
        connection.owner = self
        connection.in_turn = True
        pending.on_tick(self._account)

    def join(self, now: float) -> None:
        """Ask the sessions for the role."""
        capabilities = () if self._role is Role.EXPERIMENT else (ONE_RUN,)
        instance = chance.random_bytes(INSTANCE_SIZE)
        # Its protocol declares no name. Its address differs in each trial, so it must not name it in results.
        name, codec = f"original {self._role}", f"{_CODEC} at {self._connection.name}"
        scalars = ((PROTOCOL_VERSION,), str(self._role), instance, name, codec, capabilities)
        self._sessions.receive(self, Message(Kind.HELLO, self._session, 0, scalars), now)
        if self._decoder.buffered:
            self._connection.later()

    def deliver(self, message: Message) -> bool:
        """Accept a message from the sessions; return False if the program is gone."""
        connection = self._connection
        if connection.closed:
            return False
        try:
            delivered = self._take(message)
        except Exception:
            # An error of this program's connection must not interrupt another program.
            connection.fail()
            delivered = False
        if not delivered or connection.unsent or self._held != BASE:
            self._account()
        return delivered

    def _take(self, message: Message) -> bool:
        """Handle a message from the sessions; return False if the program is gone."""
        raise NotImplementedError

    def admits(self, role: Role, session: str) -> bool:
        """Return whether `role` of `session` can be taken at this port."""
        return role in self._port.roles and session == self._port.session

    @property
    def in_session(self) -> bool:
        """Whether it takes part in a session."""
        return self._sessions.num_sessions(self) > 0

    def evict(self, why: str) -> None:
        """Drop the connection, which uses too much memory."""
        self._connection.reset()
        self._sessions.lose(self, f"was dropped: {why}", clock.monotonic())

    def failed(self, now: float) -> None:
        """Leave the session: the connection was reset after an error of the hub."""
        self._sessions.lose(self, "was dropped after an error of the hub", now)

    def _account(self) -> bool:
        """Account for data not handled yet or not sent; return False once the connection has closed.

        Most messages leave nothing behind, and the account at `BASE`: this is called only if one does.
        """
        connection = self._connection
        held = 0
        if not connection.closed:
            held = BASE + self._decoder.buffered + connection.unsent + self._kept()
        if held != self._held:
            self._held = held
            self._sessions.memory.account(self, held)
        return not connection.closed

    def _kept(self) -> int:
        """Return the number of bytes in messages that are kept here."""
        return 0

    def ready(self, now: float) -> None:
        """Handle received data, and account for its memory."""
        self._work(now, None)
        self._settle()

    def _settle(self) -> None:
        """Account for the memory of what was received."""
        connection, memory = self._connection, self._sessions.memory
        if self._decoder.buffered or connection.unsent or connection.closed or self._held != BASE:
            self._account()
        if memory.exceeded:
            memory.enforce()

    def _work(self, now: float, data: bytes | None) -> None:
        """Handle `data`, or receive it first if it is None."""
        raise NotImplementedError


class LegacyPlayer(LegacyPeer):
    """An agent or environment, which answers calls."""

    _state = _IDLE

    _seq = 0
    """The sequence number of the call that the player was sent last."""

    _asked: Kind | None = None
    """The kind of that call; None once it is answered, and if it cannot be sent."""

    _next: Message | None = None
    """The call to send after its answer."""

    _substitute: Frame | None = None
    """The answer to a call that is not sent, since it cannot be written in the player's format."""

    # Steps have a shorter way: a call of a Python function takes as long as all that it does for a step.

    def ready(self, now: float) -> None:
        """Handle received data, and account for its memory."""
        connection, kind = self._connection, self._asked
        if kind is None or self._state is not _BUSY:
            super().ready(now)
            return
        data = connection.receive()
        answer = self._decoder.answer(data, kind) if data else None
        if answer is None:
            self._work(now, data)
            self._settle()
            return
        self._state, self._asked = _ANSWERED, None
        sessions = self._sessions
        sessions.receive(self, _message(Message, (kind, self._session, self._seq, *answer)), now)
        if connection.closed or self._held != BASE or sessions.memory.exceeded:
            self._settle()

    def deliver(self, message: Message) -> bool:
        """Accept a message from the sessions; return False if the program is gone."""
        kind, _, seq, scalars, body = message
        connection = self._connection
        if self._state is not _IDLE or kind not in _STEPS or connection.closed:
            return super().deliver(message)
        try:
            data = encode((kind, scalars, body), self._vocabulary)
        except Exception:
            return super().deliver(message)  # which meets it again
        self._state, self._seq, self._asked = _CALLED, seq, kind
        connection.send(data)
        self._loop.expect(connection)
        if connection.unsent or self._held != BASE:
            self._account()
        return True

    def _take(self, message: Message) -> bool:
        state, kind = self._state, message[0]
        if state is _GONE:
            return False
        if kind in CALLS:
            if state is not _BUSY or message[2] != self._seq:  # else the call under way is repeated
                self._state = state = PLAYER[state][_CALL]
                if state is _BUSY:
                    self._ask(message)
                else:
                    self._next = message
        elif kind is Kind.GOODBYE or kind is Kind.REFUSE:
            self._dismiss()
        return not self._connection.closed

    def _on(self, event: PlayerEvent) -> None:
        self._state = PLAYER[self._state][event]

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
        kind, _, self._seq, scalars, body = call
        try:
            data = encode((kind, scalars, body), self._vocabulary)
        except LocalProtocolError as error:
            self._substitute = Frame(Kind.ERROR, (str(ErrorCode.EXCEPTION), str(error)))
            self._connection.later()
        else:
            self._asked = kind
            self._connection.send(data)
            self._loop.expect(self._connection)

    def _work(self, now: float, data: bytes | None) -> None:
        connection, decoder = self._connection, self._decoder
        if self._substitute is not None:
            substitute, self._substitute = self._substitute, None
            self._finish_call(substitute, now)
        if data is None:
            data = connection.receive()
        if data:
            decoder.receive_data(data)
        try:
            while decoder.buffered and self._state is not _GONE:
                answer = decoder.next_event()
                if answer is None:
                    if data and decoder.buffered == HEAD_SIZE:
                        self._loop.expect(connection)  # the payload soon follows
                    break
                if answer[0] is not self._asked:
                    asked = "nothing" if self._asked is None else self._asked.name
                    raise RemoteProtocolError(f"received {answer.kind.name}; {asked} was asked")
                self._finish_call(answer, now)
        except RemoteProtocolError as error:
            self._on(PlayerEvent.LOST)
            self._sessions.malformed(self, error, now)
            self._pending.terminate(connection)
            return
        if data == b"" and self._state is not _GONE:
            self._on(PlayerEvent.LOST)
            connection.close()
            self._sessions.lose(self, "closed its connection", now)

    def _finish_call(self, answer: Frame, now: float) -> None:
        """Act on the answer to the call, which is of its kind, or an error in its place."""
        self._asked = None
        self._state = state = PLAYER[self._state][_ANSWER]
        if state is _IDLE:
            kind, scalars, body = answer
            message = _message(Message, (kind, self._session, self._seq, scalars, body))
            self._sessions.receive(self, message, now)
        elif state is _BUSY:
            call, self._next = self._next, None  # the session keeps it as long as it is needed
            assert call is not None
            self._ask(call)
        else:
            self._pending.terminate(self._connection)
