"""Original programs in their roles: between the frames of their protocol and the hub's messages.

What the two sides may count on, since original clients break without it, is in `glue.legacy.gateway`.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from typing import Final

from glue.core.config import LegacyPort
from glue.core.engine import EPISODE_VERBS
from glue.core.sessions import INSTANCE_SIZE, ONE_RUN
from glue.errors import LocalProtocolError, RemoteProtocolError
from glue.hub.connection import Connection
from glue.legacy.codec import (
    TO_AGENT,
    TO_ENVIRONMENT,
    TO_EXPERIMENT,
    Control,
    Decoder,
    Frame,
    Vocabulary,
    encode,
)
from glue.legacy.lobby import Lobby
from glue.protocol.messages import CALLS, PROTOCOL_VERSION, ErrorCode, Event, Kind, Message, Role
from glue.types import Action, body_size

__all__ = ["Experiment", "Player"]

_CODEC: Final = "RL-Glue 3.x"

_BATCH: Final = 64
"""Requests of one experiment that are carried out before the others get their turn."""

_READ_AHEAD: Final = 2**20
"""Bytes of requests that are taken in before it is their turn; more is left to hold back the sender."""

_TO_PLAYER: Final[Mapping[Role, Vocabulary]] = {Role.AGENT: TO_AGENT, Role.ENVIRONMENT: TO_ENVIRONMENT}


class Peer:
    """An original program in its role; a route of the switchboard."""

    def __init__(
        self, lobby: Lobby, connection: Connection, decoder: Decoder, role: Role, port: LegacyPort
    ) -> None:
        self._lobby = lobby
        self._connection = connection
        self._decoder = decoder
        self._role = role
        self._session = port.session
        self._port = port
        connection.ready = self._ready
        connection.in_turn = True

    def join(self, now: float) -> None:
        """Ask to be let in."""
        abilities = () if self._role is Role.EXPERIMENT else (ONE_RUN,)
        instance = os.urandom(INSTANCE_SIZE)
        scalars = ((PROTOCOL_VERSION,), str(self._role), instance, self._connection.name, _CODEC, abilities)
        self._say(Message(Kind.HELLO, self._session, 0, scalars), now)
        if self._decoder.buffered:
            self._connection.later()

    def deliver(self, message: Message) -> bool:
        """Take a message from the switchboard; return False if the program is gone."""
        raise NotImplementedError

    def admits(self, role: Role, session: str) -> bool:
        """Return whether `role` of `session` can be taken from here."""
        return role in self._port.roles and session == self._port.session

    def _ready(self, now: float) -> None:
        """Something has come, or can be done."""
        raise NotImplementedError

    def _next_frame(self) -> Frame | None:
        """Return what it has said next, if it is all there.

        Raises:
            RemoteProtocolError: it is none that may come, or too long for this hub.
        """
        frame = self._decoder.next_event()
        limit = self._lobby.hub.config.max_body
        if frame is not None and len(frame.body) > limit:
            raise RemoteProtocolError(
                f"{frame.kind.name} has a body of {len(frame.body)} bytes; this hub takes {limit}"
            )
        return frame

    def _say(self, message: Message, now: float) -> None:
        self._lobby.hub.switchboard.receive(self, message, now)

    def _log(self, line: str) -> None:
        self._lobby.log(f"session {self._session!r}: {self._role} {self._connection.name} {line}")


class Player(Peer):
    """An agent or environment: it is asked, and answers."""

    _asked: Message | None = None
    """The call that it is at work on."""

    _next: Message | None = None
    """The call to make after that; what it is at work on is of no use to anybody then."""

    _failure: Message | None = None
    """What to answer in its stead to a call that cannot be written in its format."""

    _dismissed = False
    """Whether it is to be sent off after its answer."""

    def deliver(self, message: Message) -> bool:
        kind = message.kind
        if kind in CALLS:
            if self._asked is None:
                self._ask(message)
            elif message.seq != self._asked.seq:
                self._next = message
        elif kind is Kind.GOODBYE or kind is Kind.REFUSE:
            self._dismiss()
        return not self._connection.closed

    def _dismiss(self) -> None:
        """Send it off, after its answer to whatever it is at work on; but do not wait for that for ever."""
        lobby, connection = self._lobby, self._connection
        if self._asked is None:
            lobby.send_off(connection)
        else:
            self._dismissed = True
            self._next = None
            lobby.host(connection, lambda now: lobby.send_off(connection), leaving=True)

    def _ask(self, call: Message) -> None:
        try:
            frame = encode(Frame(call.kind, call.scalars, call.body), _TO_PLAYER[self._role])
        except LocalProtocolError as error:
            scalars = (str(ErrorCode.EXCEPTION), str(error))
            self._failure = Message(Kind.ERROR, self._session, call.seq, scalars)
            self._connection.later()
        else:
            self._asked = call
            self._connection.send(frame)

    def _ready(self, now: float) -> None:
        connection = self._connection
        if self._failure is not None:
            failure, self._failure = self._failure, None
            self._say(failure, now)
        data = connection.receive()
        if data:
            self._decoder.receive_data(data)
        try:
            while (frame := self._next_frame()) is not None:
                self._answer(frame, now)
                if self._dismissed:
                    self._lobby.send_off(connection)
                    return
        except RemoteProtocolError as error:
            self._lobby.hub.switchboard.malformed(self, error, now)
            self._lobby.send_off(connection)
            return
        if data == b"":
            connection.close()
            self._lobby.hub.switchboard.lose(self, "closed its connection", now)

    def _answer(self, frame: Frame, now: float) -> None:
        asked = self._asked
        if asked is None:
            raise RemoteProtocolError(f"{frame.kind.name} came; nothing was asked")
        if frame.kind is not asked.kind:
            raise RemoteProtocolError(f"{frame.kind.name} came; {asked.kind.name} was asked")
        self._asked = None
        if self._next is not None:
            following, self._next = self._next, None
            self._ask(following)
        elif not self._dismissed:
            self._say(Message(asked.kind, self._session, asked.seq, frame.scalars, frame.body), now)


class Experiment(Peer):
    """An experiment: it asks, and is answered."""

    _seq = 0
    _asked: Message | None = None
    """The request that is being carried out."""

    _lost: str | None = None
    """A player that was lost meanwhile."""

    _again: Frame | None = None
    """The request to make once more."""

    _failure: str | None = None
    """Why it must be cut off."""

    _stepped = False
    """Whether a step has been made after which the episode went on."""

    def deliver(self, message: Message) -> bool:
        kind = message.kind
        asked = self._asked
        if kind is Kind.NOTICE:
            event, role, name = message.scalars
            if event == Event.LOST:
                self._lost = f"{role!s} {name!s}"
        elif kind is Kind.GOODBYE or kind is Kind.REFUSE:
            self._connection.reset()
        elif asked is not None and message.seq == asked.seq:
            self._asked = None
            if kind is asked.kind:
                self._reply(asked, message)
            else:
                self._fail(asked, str(message.scalars[1]))
        return not self._connection.closed

    def _reply(self, asked: Message, reply: Message) -> None:
        kind, _, _, scalars, body = reply
        if kind is Kind.RL_STEP and scalars[1] and not self._stepped:
            # The original takes the action of a terminal step from the step before: so far there is none.
            body = body[: body_size(body)] + Action().body
        elif kind is Kind.RL_STEP or (kind is Kind.RL_EPISODE and self._num_steps() > 1):
            self._stepped = True
        try:
            frame = encode(Frame(kind, scalars, body), TO_EXPERIMENT)
        except LocalProtocolError as error:
            self._cut_off(str(error))
            return
        self._connection.send(frame)
        if self._decoder.buffered:
            self._connection.later()

    def _num_steps(self) -> int:
        return self._lobby.hub.switchboard.num_steps(self._session)

    def _fail(self, asked: Message, why: str) -> None:
        if self._lost is None or asked.kind in EPISODE_VERBS:
            self._cut_off(f"its protocol cannot say that {asked.kind.name} failed: {why}")
        else:
            self._log(f"waits for another in place of the {self._lost}, to begin {asked.kind.name} again")
            self._again = Frame(asked.kind, asked.scalars, asked.body)
            self._connection.later()

    def _cut_off(self, why: str) -> None:
        self._failure = f"was cut off: {why}"
        self._connection.later()

    def _ready(self, now: float) -> None:
        connection, switchboard = self._connection, self._lobby.hub.switchboard
        if self._failure is not None:
            connection.reset()
            switchboard.lose(self, self._failure, now)
            return
        data = connection.receive()
        if data == b"":
            connection.close()
            self._goodbye(now)
            return
        if data:
            self._decoder.receive_data(data)
        try:
            self._work(now)
        except RemoteProtocolError as error:
            connection.reset()
            switchboard.malformed(self, error, now)

    @property
    def _idle(self) -> bool:
        """Whether everything taken up so far is done with."""
        under_way = self._asked or self._again or self._failure
        return not (under_way or self._connection.unsent)

    def _work(self, now: float) -> None:
        """Take up what has come, one request after the other."""
        connection, decoder = self._connection, self._decoder
        if self._again is not None:
            again, self._again = self._again, None
            self._ask(again, now)
        wanted = False
        for _ in range(_BATCH):
            if not self._idle:
                break
            request = self._next_frame()
            if request is None:
                wanted = True
                break
            if request.kind is Control.TERMINATE:
                self._lobby.send_off(connection)
                self._goodbye(now)
                return
            self._ask(request, now)
        else:
            connection.later()
        connection.read(wanted or decoder.buffered < _READ_AHEAD)

    def _ask(self, request: Frame, now: float) -> None:
        assert isinstance(request.kind, Kind)
        self._seq += 1
        self._lost = None
        self._asked = Message(request.kind, self._session, self._seq, request.scalars, request.body)
        self._say(self._asked, now)

    def _goodbye(self, now: float) -> None:
        why = "it has closed its connection" + (f" during {self._asked.kind.name}" if self._asked else "")
        self._say(Message(Kind.GOODBYE, self._session, 0, (why,)), now)
