"""The hub without its sockets: the members of sessions, and the consequences of losing a member.

A `Switchboard` takes messages and the time, and hands messages to the routes of the peers.

- A peer identifies itself, in its HELLO, by a random number: its instance. The same instance over a new
  connection is the same peer, and continues where it was (see `glue.hub.session`). Until an instance has
  sent a request or an answer, every WELCOME says that it is unknown: an earlier WELCOME may have been lost.
- A peer is lost when it is unreachable for longer than the hub's timeout, or when another peer takes its role
  meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from glue.errors import RemoteProtocolError
from glue.hub.config import HubConfig
from glue.hub.memory import Memory
from glue.hub.observers import MAX_OBSERVERS
from glue.hub.peer import Peer, Route
from glue.hub.session import Session
from glue.hub.time_bank import TimeBank
from glue.roles import CAPABILITIES
from glue.wire.codec import UnknownKind, clip
from glue.wire.messages import CALLS, OUTCOME, PROTOCOL_VERSION, ErrorCode, Event, Kind, Message, Role

INSTANCE_SIZE: Final = 16
"""Size in bytes of the random number that identifies a peer across connections."""

ONE_RUN: Final = "one-run"
"""Capability of a player that takes part in a single run: it is dismissed when the experiment leaves."""

_KNOWN: Final = frozenset({ONE_RUN, OUTCOME, *CAPABILITIES})
"""The capabilities that matter here; a peer may offer others, which are not kept."""

_CALLS: Final = frozenset(CALLS)
_EXPERIMENT: Final = Role.EXPERIMENT

_MAX_LABEL: Final = 255
"""Maximum number of bytes kept of a peer's name and codec."""


class Switchboard:
    """All sessions of a hub.

    Args:
        config: limits and times.
        log: called with one line for people about each peer that joins, leaves or is slow to answer.
        clock: returns seconds, to measure the time of agents if `config` limits it; by default the time of
            the last message or tick.

    Attributes:
        memory: bounds the memory of sessions, and of everything else that the hub keeps.
    """

    def __init__(
        self, config: HubConfig, log: Callable[[str], None], clock: Callable[[], float] | None = None
    ) -> None:
        self.memory: Memory = Memory(config.max_memory)
        self._config = config
        self.log = log
        self._now = 0.0
        self._clock = clock or (lambda: self._now)
        self._sessions: dict[str, Session] = {}
        self._seats: dict[Route, dict[str, Peer]] = {}
        """The peers of each connection, by session."""
        self._left: Callable[[Route, str], None] = lambda route, session: None

    def on_leave(self, left: Callable[[Route, str], None]) -> None:
        """Call `left` with the route and the session whenever a route takes part in a session no longer."""
        self._left = left

    def num_seats(self, route: Route) -> int:
        """Return the number of sessions in which a route takes part."""
        seats = self._seats.get(route)
        return 0 if seats is None else len(seats)

    def num_steps(self, session: str) -> int:
        """Return the current RL_num_steps of a session that has a peer."""
        return self._sessions[session].num_steps

    def capabilities(self, session: str, role: Role) -> frozenset[str] | None:
        """Return the capabilities of a session's peer; None if there is no such peer."""
        found = self._sessions.get(session)
        peer = None if found is None else found.peers.get(role)
        return None if peer is None else peer.capabilities

    def receive(self, route: Route, message: Message, now: float) -> bool:
        """Act on a message from `route`; return whether it was in turn.

        The answer to the outstanding call is in turn, and so is a request while none is being carried out.
        """
        self._now = now
        seats = self._seats.get(route)
        kind = message[0]
        peer = None if seats is None else seats.get(message[1])
        if peer is not None and (kind in _CALLS or kind is Kind.ERROR):
            if peer.role is _EXPERIMENT:
                return peer.session.request(peer, message)
            return peer.session.answer(peer, message)
        if peer is None or kind is Kind.HELLO:
            self._receive_unknown(route, message)
        elif kind is Kind.HEARTBEAT:
            self.send(route, Message(Kind.HEARTBEAT, message.session, message.seq))
        elif kind is Kind.NOTICE and message.scalars[0] == Event.SLOW:
            peer.session.explain(peer, message)
        elif kind is Kind.GOODBYE:
            self._lose(peer, f"left: {clip(str(message.scalars[0]))}")
            if peer.role is Role.EXPERIMENT:
                self._end_run(peer.session)
        elif kind is Kind.OBSERVE and peer.session.observers is not None and peer.role is Role.OBSERVER:
            moments = message.scalars[0]
            assert isinstance(moments, int)
            peer.session.observers.want(peer, moments)
        else:
            text = f"{kind.name} is not for this {peer.role} to send"
            self._error(route, message, ErrorCode.NOT_ASKED, text)
        return False

    def malformed(self, route: Route, error: RemoteProtocolError, now: float) -> None:
        """Act on bytes from `route` that are not a message: their sender loses its seats.

        A message of an unknown kind, which may be of a newer protocol, is only answered with an ERROR.
        """
        self._now = now
        if isinstance(error, UnknownKind):
            message = Message(Kind.ERROR, error.session, error.seq)
            self._error(route, message, ErrorCode.UNKNOWN_KIND, str(error))
            return
        self._error(route, Message(Kind.ERROR, "", 0), ErrorCode.MALFORMED, str(error))
        self.lose(route, f"sent a malformed message: {error}", now, ErrorCode.PEER_FAILED)

    def lose(self, route: Route, why: str, now: float, code: ErrorCode = ErrorCode.PEER_LOST) -> None:
        """Continue without the peers of `route`; `why` completes a sentence about them."""
        self._now = now
        for peer in list(self._seats.get(route, {}).values()):
            self._lose(peer, why, code)

    def tick(self, now: float) -> None:
        """Send every connection a heartbeat, and give up peers that have been unreachable for too long."""
        self._now = now
        for route, seats in list(self._seats.items()):
            reached = self.send(route, Message(Kind.HEARTBEAT, "", 0))
            for peer in list(seats.values()):
                if not reached:
                    self._mark_unreachable(peer)
                elif peer.unreachable_since is not None:
                    # Its connection is intact, but its queue was full and a message was dropped.
                    peer.unreachable_since = None
                    peer.session.repeat(peer)
                since = peer.unreachable_since
                if since is not None and now - since >= self._config.timeout:
                    self._lose(peer, f"was unreachable for {now - since:.1f} s")
        for session in list(self._sessions.values()):
            session.report_if_slow(now)
            session.enforce_time()
        self.memory.relieve()

    def close(self, reason: str) -> None:
        """Say goodbye to every peer, as the hub ends."""
        for route, seats in self._seats.items():
            for session in seats:
                self.send(route, Message(Kind.GOODBYE, session, 0, (reason,)))
        self._seats.clear()
        self._sessions.clear()

    def _receive_unknown(self, route: Route, message: Message) -> None:
        if message.kind is not Kind.HELLO:
            text = f"this connection has not joined session {message.session!r}; say HELLO first"
            self._error(route, message, ErrorCode.UNKNOWN_PEER, text)
            return
        refusal = self._greet(route, message)
        if refusal is not None:
            code, text = refusal
            self.log(f"refused a peer of session {message.session!r}: {text}")
            self.send(route, Message(Kind.REFUSE, message.session, message.seq, (str(code), clip(text))))

    def _greet(self, route: Route, message: Message) -> tuple[ErrorCode, str] | None:
        """Admit the sender of a HELLO, or return why not."""
        versions, role_name, instance, name, codec, capabilities = message.scalars
        assert isinstance(versions, tuple)
        assert isinstance(instance, bytes)
        assert isinstance(capabilities, tuple)
        assert isinstance(name, str)
        assert isinstance(codec, str)
        if PROTOCOL_VERSION not in versions:
            text = f"this hub supports protocol version {PROTOCOL_VERSION}, the peer {list(versions)}"
            return ErrorCode.VERSION, text
        try:
            role = Role(str(role_name))
        except ValueError:
            return ErrorCode.MALFORMED, f"the role must be one of {', '.join(Role)}, not {role_name!r:.40}"
        if len(instance) != INSTANCE_SIZE:
            return ErrorCode.MALFORMED, f"an instance must have {INSTANCE_SIZE} bytes, not {len(instance)}"
        if not message.session or not message.session.isprintable():
            return (
                ErrorCode.MALFORMED,
                "the name of a session must have printable characters, and at least one",
            )
        if not route.admits(role, message.session):
            text = (
                f"no {role} of session {message.session!r} may join at this address of the hub, or with this "
                "key: ask whoever runs it"
            )
            return ErrorCode.NOT_ADMITTED, text
        seats = self._seats.get(route, {})
        if message.session not in seats and len(seats) >= self._config.max_seats:
            text = f"this connection takes part in {len(seats)} sessions, the maximum; open another one"
            return ErrorCode.FULL, text
        if role is Role.OBSERVER:
            return self._greet_observer(route, message, instance, str(name), str(codec))
        session = self._sessions.get(message.session)
        if session is None:
            if len(self._sessions) >= self._config.max_sessions:
                text = f"this hub serves {self._config.max_sessions} sessions at once, and all are in use"
                return ErrorCode.FULL, text
            bank = None if self._config.time is None else TimeBank(self._config.time, self._clock)
            session = self._sessions[message.session] = Session(self, message.session, bank)
        other = seats.get(message.session)
        if other is not None and other.role is not role:
            return ErrorCode.MALFORMED, f"this connection is already the {other.role} of the session"
        current = session.peers.get(role)
        if current is not None and current.instance != instance:
            if current.unreachable_since is None and self._reach(current):
                text = f"session {session.name!r} already has an {role}: {current.label}"
                return ErrorCode.ROLE_TAKEN, text
            self._lose(current, "was replaced by another")
            current = None
        known = session.knows(role, instance)
        # Over one connection nothing is lost: the sender has read, or will read, the previous WELCOME.
        resumed = known or (current is not None and current.route == route)
        self._welcome(route, message, resumed)
        if current is not None:
            if current.route == route:
                # It has missed nothing. Sending more again would let it fill the hub's memory.
                return None
            self._unseat(current)
        offered = _KNOWN.intersection(map(str, capabilities))
        peer = Peer(session, role, route, instance, *_named(name, codec), offered, known)
        self._sessions[session.name] = session
        self._seats.setdefault(route, {})[session.name] = peer
        if current is None:
            self.log(f"session {session.name!r}: {role} {peer.label} {'returned' if known else 'joined'}")
        session.join(peer, same=known or current is not None, announce=current is None)
        return None

    def _welcome(self, route: Route, message: Message, resumed: bool) -> None:
        """Answer a HELLO whose sender is admitted."""
        config = self._config
        welcome = (PROTOCOL_VERSION, resumed, config.heartbeat, config.timeout, config.max_body)
        self.send(route, Message(Kind.WELCOME, message.session, message.seq, welcome))

    def _greet_observer(
        self, route: Route, message: Message, instance: bytes, name: str, codec: str
    ) -> tuple[ErrorCode, str] | None:
        """Admit the sender of a HELLO as an observer, which opens no session, or return why not."""
        session = self._sessions.get(message.session)
        if session is None:
            return ErrorCode.NO_SESSION, f"there is no session {message.session!r} yet; say HELLO again later"
        current = self._seats.get(route, {}).get(message.session)
        if current is not None:
            if current.role is not Role.OBSERVER:
                return ErrorCode.MALFORMED, f"this connection is already the {current.role} of the session"
            self._welcome(route, message, resumed=True)
            return None
        others = session.observers.peers if session.observers is not None else []
        if len(others) >= MAX_OBSERVERS:
            gone = [other for other in others if not self._reach(other)]
            if not gone:
                return ErrorCode.FULL, f"session {session.name!r} has {MAX_OBSERVERS} observers, the maximum"
            for other in gone:
                self._lose(other, "is gone")
        peer = Peer(
            session, Role.OBSERVER, route, instance, *_named(name, codec), frozenset(), confirmed=True
        )
        self._seats.setdefault(route, {})[session.name] = peer
        self.log(f"session {session.name!r}: observer {peer.label} joined")
        self._welcome(route, message, resumed=False)
        session.observe(peer, lambda observer, shown: self.send(observer.route, shown))
        return None

    def end(self, session: Session, why: str) -> None:
        """End a session: say goodbye to all its peers."""
        goodbye = Message(Kind.GOODBYE, session.name, 0, (clip(f"the session was ended: {why}"),))
        # The experiment first: with it gone, no notices of the players' loss are sent.
        for role in (Role.EXPERIMENT, Role.AGENT, Role.ENVIRONMENT):
            peer = session.peers.get(role)
            if peer is not None:
                self._lose(peer, f"was dismissed: {why}")
                self.send(peer.route, goodbye)

    def dismiss(self, player: Peer, why: str) -> None:
        """Say goodbye to a failed player, and continue without it; `why` completes a sentence about it."""
        self.send(player.route, Message(Kind.GOODBYE, player.session.name, 0, (clip(f"it {why}"),)))
        self._lose(player, why, ErrorCode.PEER_FAILED)

    def _end_run(self, session: Session) -> None:
        """Say goodbye to the players that take part in a single run, which is over."""
        for player in list(session.peers.values()):
            if ONE_RUN in player.capabilities:
                goodbye = Message(Kind.GOODBYE, session.name, 0, ("the experiment is over",))
                self.send(player.route, goodbye)
                self._lose(player, "was dismissed: the experiment is over")

    def _unseat(self, peer: Peer) -> None:
        seats = self._seats[peer.route]
        del seats[peer.session.name]
        if not seats:
            del self._seats[peer.route]
        self._left(peer.route, peer.session.name)

    def send(self, route: Route, message: Message) -> bool:
        """Send `message`; return False, having sent nothing, if the other side is gone or does not read."""
        return route.deliver(message)

    def _reach(self, peer: Peer) -> bool:
        return self.send(peer.route, Message(Kind.HEARTBEAT, "", 0))

    def _lose(self, peer: Peer, why: str, code: ErrorCode = ErrorCode.PEER_LOST) -> None:
        session = peer.session
        self._unseat(peer)
        self.log(f"session {session.name!r}: {peer.role} {peer.label} {why}")
        session.lose(peer, why, code)
        if not session.peers and peer.role is not Role.OBSERVER:
            self._sessions.pop(session.name, None)
            self.memory.hold(session, 0)
            for observer in session.observers.peers if session.observers is not None else []:
                self.send(observer.route, Message(Kind.GOODBYE, session.name, 0, ("the session is over",)))
                self._lose(observer, "was dismissed: the session is over")

    def _error(self, route: Route, message: Message, code: ErrorCode, text: str) -> None:
        self.send(route, Message(Kind.ERROR, message.session, message.seq, (str(code), clip(text))))

    def deliver(self, peer: Peer, message: Message) -> None:
        """Send `message` to `peer`; start its timeout if it cannot be reached."""
        if not peer.route.deliver(message):
            self._mark_unreachable(peer)

    def _mark_unreachable(self, peer: Peer) -> None:
        if peer.unreachable_since is None:
            peer.unreachable_since = self._now


def _named(name: str, codec: str) -> tuple[str, str]:
    """Return the name of a peer for error messages, and its label for notices and the log."""
    return clip(name, _MAX_LABEL), clip(f"{name} ({codec})", _MAX_LABEL)
