"""Original programs as experiments: translation between frames of their protocol and messages.

`glue.legacy.gateway` explains the rules for original programs; `glue.legacy.states` has the states.
"""

from __future__ import annotations

from typing import Final

from glue.engine.engine import EPISODE_VERBS
from glue.errors import LocalProtocolError, RemoteProtocolError
from glue.legacy.codec import FROM, Control, Frame, encode
from glue.legacy.peers import BASE, LegacyPeer
from glue.legacy.states import EXPERIMENT, ExperimentEvent, ExperimentState
from glue.types import Action, body_size
from glue.wire.messages import Event, Kind, Message, Role

# Bound once: looking up a member of an enum takes longer than comparing with it.
_IDLE: Final = ExperimentState.IDLE
_WAITING: Final = EXPERIMENT[_IDLE][ExperimentEvent.REQUEST]
_REPLIED: Final = EXPERIMENT[_WAITING][ExperimentEvent.REPLY]
_RL_STEP: Final = Kind.RL_STEP
_STEP: Final = encode(Frame(_RL_STEP), FROM[Role.EXPERIMENT])

_message: Final = tuple.__new__
"""Constructor of a named tuple, at half the cost of calling its class."""

READ_AHEAD: Final = 2**20
"""Maximum size in bytes of requests received before their turn; the rest stays in the network."""


class LegacyExperiment(LegacyPeer):
    """An experiment, which makes requests."""

    _state = ExperimentState.IDLE

    _seq = 0

    _request: Message | None = None
    """The request in progress, or the one to repeat."""

    _lost_player = ""
    """The role and name of the player lost last, for the log."""

    _failure = ""
    """The reason for which the connection will be reset."""

    _has_stepped = False
    """Whether any step so far did not end its episode."""

    _sends_ahead = False
    """Whether the newest request was sent before the reply to the previous one, or is followed by another.

    A program that waits for each reply has left if its data ends; only a program that sends requests ahead
    closes its sending half while it still needs the other half.
    """

    _closed = False
    """Whether the sending half is closed, and the program waits for replies."""

    _ahead: Frame | None = None
    """The request after the newest one, if it was read before its turn."""

    # Steps have a shorter way, as in `glue.legacy.peers.LegacyPlayer`.

    def ready(self, now: float) -> None:
        """Handle received data, and account for its memory."""
        connection, decoder = self._connection, self._decoder
        if self._state is not _IDLE or connection.unsent or decoder.buffered or self._ahead or self._closed:
            super().ready(now)
            return
        data = connection.receive()
        if data != _STEP or decoder.overhang:
            self._work(now, data)
            self._settle()
            return
        self._state, self._sends_ahead = _WAITING, False
        self._seq += 1
        self._request = _message(Message, (_RL_STEP, self._session, self._seq, (), b""))
        sessions = self._sessions
        sessions.receive(self, self._request, now)
        connection.read(True)
        if connection.closed or self._held != BASE or sessions.memory.exceeded:
            self._settle()

    def deliver(self, message: Message) -> bool:
        """Accept a message from the sessions; return False if the program is gone."""
        kind, _, seq, scalars, body = message
        connection = self._connection
        if (
            kind is not _RL_STEP
            or self._state is not _WAITING
            or seq != self._seq
            or not self._has_stepped
            or self._decoder.buffered
            or self._closed
            or connection.closed
        ):
            return super().deliver(message)
        try:
            data = encode((kind, scalars, body), self._vocabulary)
        except Exception:
            return super().deliver(message)  # which meets it again
        self._state = _REPLIED
        connection.send(data)
        self._loop.expect(connection)  # the next request soon follows
        if connection.unsent or self._held != BASE:
            self._account()
        return True

    def _take(self, message: Message) -> bool:
        if self._state is ExperimentState.GONE:
            return False
        kind, request = message.kind, self._request
        waiting = ExperimentEvent.REPLY in EXPERIMENT[self._state]
        if waiting and request is not None and message.seq == request.seq:
            if kind is request.kind:
                self._reply(message)
            else:
                self._fail(request.kind, str(message.scalars[1]))
        elif kind is Kind.NOTICE:
            event, role, name = message.scalars
            if event == Event.LOST:
                self._lost_player = f"{role!s} {name!s}"
                self._on(ExperimentEvent.PLAYER_LOST)
        elif kind is Kind.GOODBYE or kind is Kind.REFUSE:
            self._on(ExperimentEvent.LEFT)
            self._connection.reset()
        return not self._connection.closed

    def _kept(self) -> int:
        return sum(len(kept.body) for kept in (self._request, self._ahead) if kept is not None)

    def _on(self, event: ExperimentEvent) -> None:
        self._state = EXPERIMENT[self._state][event]

    def _reply(self, reply: Message) -> None:
        kind, _, _, scalars, body = reply
        if kind is _RL_STEP and scalars[1] and not self._has_stepped:
            # The original repeats the previous step's action in a terminal step; so far there is none.
            body = body[: body_size(body)] + Action().body
        elif kind is _RL_STEP or (kind is Kind.RL_EPISODE and self._sessions.num_steps(self._session) > 1):
            self._has_stepped = True
        try:
            frame = encode((kind, scalars, body), self._vocabulary)
        except LocalProtocolError as error:
            self._on(ExperimentEvent.FAILURE)
            self._reset_later(str(error))
            return
        self._on(ExperimentEvent.REPLY)
        self._connection.send(frame)
        if self._closed:
            self._expect_end()
        if self._decoder.buffered or self._closed:
            self._connection.later()

    def _fail(self, kind: Kind, why: str) -> None:
        repeatable = kind not in EPISODE_VERBS
        self._on(ExperimentEvent.REPEATABLE_FAILURE if repeatable else ExperimentEvent.FAILURE)
        if self._state is ExperimentState.FAILED:
            self._reset_later(f"its protocol cannot say that {kind.name} failed: {why}")
            return
        self._pending.log(
            f"session {self._session!r}: {self._role} {self._connection.name} waits for another player in "
            f"place of the {self._lost_player}, to begin {kind.name} again"
        )
        self._connection.later()

    def _reset_later(self, why: str) -> None:
        self._failure = f"was cut off: {why}"
        self._connection.later()

    def _work(self, now: float, data: bytes | None) -> None:
        connection = self._connection
        if self._state is ExperimentState.FAILED:
            self._on(ExperimentEvent.LEFT)
            connection.reset()
            self._sessions.lose(self, self._failure, now)
            return
        try:
            self._take_up(now, data)
        except RemoteProtocolError as error:
            self._on(ExperimentEvent.LEFT)
            connection.reset()
            self._sessions.malformed(self, error, now)

    def _take_up(self, now: float, data: bytes | None) -> None:
        """Start at most one request, so that every session gets its turn, and receive more data."""
        connection, decoder = self._connection, self._decoder
        if self._state is ExperimentState.RETRYING:
            assert self._request is not None
            self._seq += 1
            self._carry_out(self._request._replace(seq=self._seq), now)
        request = self._next_request() if decoder.buffered or self._ahead else None
        early = request is not None and self._request is not None
        if request is None:
            # Only now, so that requests made before the connection was closed are executed.
            if data is None:
                data = connection.receive() if not (self._closed and self._is_free) else b""
            if data:
                decoder.receive_data(data)
                request = self._next_request()
            elif data == b"" and self._has_left():
                self._end(now)
                return
        incomplete = request is None and self._is_free
        if request is not None:
            if request.kind is Control.TERMINATE:
                self._pending.terminate(connection)
                self._leave(now)
                return
            assert isinstance(request.kind, Kind)
            self._sends_ahead = early or decoder.buffered > 0
            self._seq += 1
            self._carry_out(_message(Message, (request.kind, self._session, self._seq, *request[1:])), now)
            if decoder.buffered and self._is_free:
                connection.later()
        wanted = incomplete or decoder.buffered < READ_AHEAD
        connection.read(wanted and not self._closed)

    @property
    def _is_free(self) -> bool:
        """Whether the next request can be started: the reply to the previous one has been sent."""
        return self._state is _IDLE and not self._connection.unsent

    def _next_request(self) -> Frame | None:
        if not self._is_free:
            return None
        ahead, self._ahead = self._ahead, None
        return ahead or self._decoder.next_event()

    def _has_left(self) -> bool:
        """Return whether the end of its data means that the program has left; if not, expect its end."""
        if self._is_free or self._closed:
            return True
        if self._ahead is None:
            self._ahead = self._decoder.next_event()
            self._sends_ahead |= self._ahead is not None and self._ahead.kind is not Control.TERMINATE
        if self._sends_ahead:
            self._closed = True
            self._expect_end()
        return not self._closed

    def _carry_out(self, request: Message, now: float) -> None:
        self._on(ExperimentEvent.REQUEST)
        self._request = request
        if request.body:
            self._account()  # what is kept without having been buffered
        self._sessions.receive(self, request, now)

    def _expect_end(self) -> None:
        """Apply the hub's timeout to the pending request: its sender may be gone."""
        self._pending.add(self._connection, self._end, closing=True)

    def _end(self, now: float) -> None:
        self._connection.close()
        self._leave(now)

    def _leave(self, now: float) -> None:
        why = "it has closed its connection"
        if ExperimentEvent.REPLY in EXPERIMENT[self._state] and self._request is not None:
            why += f" during {self._request.kind.name}"
        self._on(ExperimentEvent.LEFT)
        self._sessions.receive(self, Message(Kind.GOODBYE, self._session, 0, (why,)), now)
