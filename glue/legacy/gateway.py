"""Original RL-Glue programs as peers of the hub: listeners in the hub's own loop.

To a session an original program is a peer like any other. What it sends becomes messages for the
switchboard, and what the switchboard has for it becomes frames, one at a time:

- A player, that is an agent or environment, is sent a call only after it has answered the one before,
  even if nobody waits for that answer any more: a Java program loses what comes with something else.
- An experiment's next request is taken up only after the reply to the one before has been sent.
- A player takes part in one run, as originals do. It is sent off with message 35, on which it ends:
  when the experiment leaves, when the hub ends, when its role is taken, and when it breaks the
  protocol. A bare end of connection would make C programs run wild and Python ones hang.
- An experiment cannot be told that a call failed. If a player was lost, and the call can be made from
  its beginning with another, it is made again. If not, the connection is reset: after a mere end of
  connection C programs would go on with old numbers, and Python ones hang.

Source: RL-Glue core 3.04, RL_network_glue.c; rl-glue-ext, the C, Java and Python codecs.
"""

from __future__ import annotations

import errno
import os
import socket
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final

import zmq

from glue.config import LegacyPort
from glue.engine import EPISODE_VERBS
from glue.errors import ConfigError, LocalProtocolError, RemoteProtocolError
from glue.hub import Hub
from glue.legacy.codec import (
    FROM_AGENT,
    FROM_ENVIRONMENT,
    FROM_EXPERIMENT,
    FROM_STRANGER,
    TO_AGENT,
    TO_ENVIRONMENT,
    TO_EXPERIMENT,
    Control,
    Decoder,
    Frame,
    Vocabulary,
    encode,
)
from glue.legacy.connection import Connection
from glue.messages import CALLS, PROTOCOL_VERSION, ErrorCode, Event, Kind, Message, Role
from glue.sessions import INSTANCE_SIZE, ONE_RUN
from glue.types import Action, body_size

__all__ = ["Gateway"]

Log = Callable[[str], None]

_CODEC: Final = "RL-Glue 3.x"

_MAX_GUESTS: Final = 256
"""Connections without a role that are kept at once; one more costs the oldest its place."""

_BACKLOG: Final = 1024
"""Connections that the system takes in before we do; Java programs try hundreds of times a second."""

_BATCH: Final = 64
"""What one source may bring, connections or requests, before the others get their turn."""

_READ_AHEAD: Final = 2**20
"""Bytes of requests that are taken in before it is their turn; more is left to hold back the sender."""

_FAREWELL_SECONDS: Final = 1.0
"""How long the end of the hub is put off, at most, for programs to take their leave."""

_ROLES: Final[Mapping[Kind | Control, Role]] = {
    Control.CONNECT_AGENT: Role.AGENT,
    Control.CONNECT_ENVIRONMENT: Role.ENVIRONMENT,
    Control.CONNECT_EXPERIMENT: Role.EXPERIMENT,
}
_FROM: Final[Mapping[Role, Vocabulary]] = {
    Role.AGENT: FROM_AGENT,
    Role.ENVIRONMENT: FROM_ENVIRONMENT,
    Role.EXPERIMENT: FROM_EXPERIMENT,
}
_TO_PLAYER: Final[Mapping[Role, Vocabulary]] = {Role.AGENT: TO_AGENT, Role.ENVIRONMENT: TO_ENVIRONMENT}
_TERMINATE: Final = encode(Frame(Control.TERMINATE), TO_AGENT)


@dataclass(slots=True)
class _Guest:
    """A connection that may stay for a while.

    Attributes:
        expire: ends its stay, given the time.
        leaving: it is on its way out, and the hub does not end in the middle of that.
        since: when its time began to run.
    """

    expire: Callable[[float], None]
    leaving: bool
    since: float | None = None


class Gateway:
    """Lets original programs into the sessions of `hub`, from the moment it is made until the hub ends.

    Args:
        hub: a hub that does not run yet.
        ports: where to listen, and which session is joined there.
        log: takes a line for people about each connection that is refused, dropped or in trouble.

    Attributes:
        ports: the same, free ports resolved.

    Raises:
        ConfigError: an address is taken, or cannot be listened on.
    """

    def __init__(self, hub: Hub, ports: Sequence[LegacyPort], log: Log = lambda line: None) -> None:
        self.hub = hub
        self.log = log
        self._guests: dict[Connection, _Guest] = {}
        self._listeners: list[_Listener] = []
        try:
            for port in ports:
                self._listeners.append(_Listener(self, port))
        except ConfigError:
            self._stop_listening()
            raise
        self.ports = [listener.port for listener in self._listeners]
        hub.on_tick(self._tick)
        hub.on_close(self._close)

    def host(self, connection: Connection, expire: Callable[[float], None], leaving: bool = False) -> None:
        """Let `connection` stay without a role; once the hub's patience is over, call `expire`."""
        self._guests[connection] = _Guest(expire, leaving)

    def seat(self, connection: Connection) -> None:
        """Let `connection`, which has a role now, stay for good."""
        del self._guests[connection]

    def make_room(self, now: float) -> None:
        """See that there is room for one more connection without a role."""
        if len(self._guests) >= _MAX_GUESTS:
            self._guests = {known: guest for known, guest in self._guests.items() if not known.closed}
        while len(self._guests) >= _MAX_GUESTS:
            oldest = next(iter(self._guests))
            self.log(f"{oldest.name} must go: {_MAX_GUESTS} connections without a role are there already")
            self._guests.pop(oldest).expire(now)

    def send_off(self, connection: Connection) -> None:
        """Send message 35, and hear no more of what is said."""
        connection.send(_TERMINATE)
        connection.finish()
        self.host(connection, lambda now: connection.close(), leaving=True)

    def _tick(self, now: float) -> None:
        for listener in self._listeners:
            listener.listen()
        for connection, guest in list(self._guests.items()):
            if guest.since is None:
                guest.since = now
            if connection.closed:
                del self._guests[connection]
            elif now - guest.since >= self.hub.config.patience:
                del self._guests[connection]
                guest.expire(now)

    def _close(self) -> None:
        """Wait a moment for those who were sent off: their last words should meet an open connection."""
        self._stop_listening()
        deadline = time.monotonic() + _FAREWELL_SECONDS
        while (now := time.monotonic()) < deadline and (leaving := self._leaving()):
            poller = zmq.Poller()
            for fd, connection in leaving.items():
                poller.register(fd, connection.events)
            for fd, _ in poller.poll(int((deadline - now) * 1000)):
                leaving[fd].turn(now)
        for connection, guest in list(self._guests.items()):
            if not connection.closed:
                guest.expire(now)
                connection.close()

    def _leaving(self) -> dict[int, Connection]:
        guests = self._guests.items()
        return {known.fileno(): known for known, guest in guests if guest.leaving and not known.closed}

    def _stop_listening(self) -> None:
        for listener in self._listeners:
            listener.close()


class _Listener:
    """One port and its session."""

    def __init__(self, gateway: Gateway, port: LegacyPort) -> None:
        self._gateway = gateway
        family = socket.AF_INET6 if ":" in port.host else socket.AF_INET
        try:
            self._socket = socket.create_server((port.host, port.port), family=family, backlog=_BACKLOG)
        except OSError as error:
            raise ConfigError(_cannot_listen(port, error)) from None
        self._socket.setblocking(False)
        self.port = replace(port, port=self._socket.getsockname()[1])
        self.listen()

    def listen(self) -> None:
        """Accept connections, again if it was given up for want of descriptors."""
        self._gateway.hub.watch(self._socket.fileno(), zmq.POLLIN, self._accept)

    def close(self) -> None:
        """Stop listening."""
        self._gateway.hub.unwatch(self._socket.fileno())
        self._socket.close()

    def _accept(self, now: float) -> None:
        gateway = self._gateway
        for _ in range(_BATCH):
            try:
                connected, address = self._socket.accept()
            except BlockingIOError:
                return
            except OSError as error:
                gateway.log(f"cannot accept a connection for now: {error.strerror}")
                gateway.hub.watch(self._socket.fileno(), zmq.POLLERR, self._accept)
                return
            gateway.make_room(now)
            name = f"{address[0]}:{address[1]}"
            try:
                _Stranger(gateway, Connection(gateway.hub, connected, name), self.port.session)
            except OSError:
                # Gone already.
                connected.close()


def _cannot_listen(port: LegacyPort, error: OSError) -> str:
    if error.errno == errno.EADDRINUSE:
        return (
            f"cannot listen for original RL-Glue programs on {port}: the port is in use; is the rl_glue "
            f"server or another hub running? Stop it, or choose another port with --legacy-port"
        )
    # Python adds the address to the text of the system's own errors; those of names are negative.
    number = error.errno or 0
    reason = os.strerror(number) if number > 0 else error.strerror
    return f"cannot listen for original RL-Glue programs on {port}: {reason}"


class _Stranger:
    """A connection that has not said what it is."""

    def __init__(self, gateway: Gateway, connection: Connection, session: str) -> None:
        self._gateway = gateway
        self._connection = connection
        self._session = session
        self._decoder = Decoder(FROM_STRANGER)
        connection.ready = self._ready
        gateway.host(connection, self._expire)

    def _ready(self, now: float) -> None:
        connection, decoder = self._connection, self._decoder
        data = connection.receive()
        if data is None:
            return
        if not data:
            # A port probe.
            connection.close()
            return
        decoder.receive_data(data)
        try:
            hello = decoder.next_event()
        except RemoteProtocolError as error:
            self._gateway.log(f"{connection.name} is no RL-Glue program: {error}")
            connection.close()
            return
        if hello is not None:
            self._gateway.seat(connection)
            role = _ROLES[hello.kind]
            decoder.expect(_FROM[role])
            made = _Experiment if role is Role.EXPERIMENT else _Player
            made(self._gateway, connection, decoder, role, self._session).join(now)

    def _expire(self, now: float) -> None:
        self._gateway.log(f"{self._connection.name} has not said what it is; it is dropped")
        self._connection.close()


class _Peer:
    """An original program in its role; a route of the switchboard."""

    def __init__(
        self, gateway: Gateway, connection: Connection, decoder: Decoder, role: Role, session: str
    ) -> None:
        self._gateway = gateway
        self._connection = connection
        self._decoder = decoder
        self._role = role
        self._session = session
        connection.ready = self._ready

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

    def _ready(self, now: float) -> None:
        """Something has come, or can be done."""
        raise NotImplementedError

    def _next_frame(self) -> Frame | None:
        """Return what it has said next, if it is all there.

        Raises:
            RemoteProtocolError: it is none that may come, or too long for this hub.
        """
        frame = self._decoder.next_event()
        limit = self._gateway.hub.config.max_body
        if frame is not None and len(frame.body) > limit:
            raise RemoteProtocolError(
                f"{frame.kind.name} has a body of {len(frame.body)} bytes; this hub takes {limit}"
            )
        return frame

    def _say(self, message: Message, now: float) -> None:
        self._gateway.hub.switchboard.receive(self, message, now)

    def _log(self, line: str) -> None:
        self._gateway.log(f"session {self._session!r}: {self._role} {self._connection.name} {line}")


class _Player(_Peer):
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
            if self._asked is None:
                self._gateway.send_off(self._connection)
            else:
                self._dismissed = True
                send_off = self._gateway.send_off
                self._gateway.host(self._connection, lambda now: send_off(self._connection), leaving=True)
        return not self._connection.closed

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
                    self._gateway.send_off(connection)
                    return
        except RemoteProtocolError as error:
            self._gateway.hub.switchboard.malformed(self, error, now)
            self._gateway.send_off(connection)
            return
        if data == b"":
            connection.close()
            self._gateway.hub.switchboard.lose(self, "closed its connection", now)

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


class _Experiment(_Peer):
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
        elif kind is Kind.RL_STEP or (kind is Kind.RL_EPISODE and asked.scalars != (1,)):
            self._stepped = True
        try:
            frame = encode(Frame(kind, scalars, body), TO_EXPERIMENT)
        except LocalProtocolError as error:
            self._cut_off(str(error))
            return
        self._connection.send(frame)
        if self._decoder.buffered:
            self._connection.later()

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
        connection, switchboard = self._connection, self._gateway.hub.switchboard
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
        return not (under_way or self._connection.sending)

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
                self._gateway.send_off(connection)
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
