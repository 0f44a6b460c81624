"""The hub without its sockets: peers, sessions, and what happens when one goes away.

A `Switchboard` takes messages and the time, and hands messages to the routes of the peers. A session
is one engine and up to three peers. Three rules make a step happen exactly once however often the
network drops:

- Every call carries a sequence number, and its answer names it. An answer to anything but the call
  that is outstanding changes nothing.
- A peer says who it is, in its HELLO, by a random number of its own: its instance. When the same
  instance comes back over a new connection, the outstanding call is sent again; the peer, if it has
  answered already, repeats its answer. In the same way an experiment is sent the last reply again.
  Until an instance has sent a request or an answer it is told that it is unknown, as often as it comes:
  the WELCOME that said so before may have been lost.
- A peer that stays unreachable for longer than the hub's patience, or in whose place another appears,
  is lost: the episode under way is void, and the experiment is told.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final, Protocol

from glue.core.calls import skippable, unsupported
from glue.core.config import HubConfig
from glue.core.engine import Engine, Instruction
from glue.core.memory import Memory
from glue.errors import PeerLost, RemoteProtocolError
from glue.protocol.messages import CALLS, PROTOCOL_VERSION, ErrorCode, Event, Kind, Message, Role
from glue.protocol.wire import UnknownKind, clip
from glue.types import Action

__all__ = ["INSTANCE_SIZE", "ONE_RUN", "Route", "Switchboard"]

INSTANCE_SIZE: Final = 16
"""Bytes of the random number by which a peer is known across connections."""

ONE_RUN: Final = "one-run"
"""Capability of a player that takes part in one run alone: it is sent off when the experiment leaves."""

_SLOW_SECONDS: Final = 5.0
"""How long a player may take for an answer before it is mentioned."""

_RARER: Final = 6.0
"""Each mention comes after so many times as long as the one before: after 5 s, 30 s, 180 s, ..."""

_LIGHT: Final = 65_536
"""Bytes of bodies that a session may keep without being accounted for: 64 MiB in 1024 sessions."""

_MAX_LABEL: Final = 255
"""Bytes of a peer's name and codec that are kept."""


class Route(Protocol):
    """A connection: where messages come from, and where they can go."""

    def deliver(self, message: Message) -> bool:
        """Send `message`; return False, having sent nothing, if the other side is gone or does not read."""
        ...

    def admits(self, role: Role, session: str) -> bool:
        """Return whether this role of this session can be taken from here; see `glue.core.config.Bind`."""
        ...


class _Peer:
    """A role filled: who fills it, and the route to it."""

    __slots__ = (
        "capabilities",
        "confirmed",
        "instance",
        "label",
        "role",
        "route",
        "session",
        "unreachable_since",
    )

    def __init__(
        self,
        session: _Session,
        role: Role,
        route: Route,
        instance: bytes,
        label: str,
        capabilities: frozenset[str],
        confirmed: bool,
    ) -> None:
        self.session = session
        self.role = role
        self.route = route
        self.instance = instance
        self.label = label
        self.capabilities = capabilities
        self.confirmed = confirmed
        self.unreachable_since: float | None = None


class Switchboard:
    """All sessions of a hub.

    Args:
        config: limits and times.
        log: takes one line for people about each peer that joins, leaves or is slow to answer.

    Attributes:
        memory: bounds what is kept for sessions, and for whatever else the hub keeps.
    """

    def __init__(self, config: HubConfig, log: Callable[[str], None]) -> None:
        self.memory = Memory(config.max_memory)
        self._config = config
        self.log = log
        self._now = 0.0
        self._sessions: dict[str, _Session] = {}
        self._seats: dict[Route, dict[str, _Peer]] = {}
        """The peers of each connection, by session."""

    def num_seats(self, route: Route) -> int:
        """Return in how many sessions a route takes part."""
        seats = self._seats.get(route)
        return 0 if seats is None else len(seats)

    def num_steps(self, session: str) -> int:
        """Return what RL_num_steps is at present in a session that has a peer."""
        return self._sessions[session].num_steps

    def receive(self, route: Route, message: Message, now: float) -> bool:
        """Act on a message from `route`; return whether it was in turn.

        In turn are the answer to the outstanding call, and a request while none is being carried out.
        """
        self._now = now
        seats = self._seats.get(route)
        peer = None if seats is None else seats.get(message.session)
        kind = message.kind
        if peer is None or kind is Kind.HELLO:
            self._receive_from_stranger(route, message)
        elif kind in CALLS or kind is Kind.ERROR:
            if peer.role is Role.EXPERIMENT:
                return peer.session.request(peer, message)
            return peer.session.answer(peer, message)
        elif kind is Kind.HEARTBEAT:
            self.send(route, Message(Kind.HEARTBEAT, message.session, message.seq))
        elif kind is Kind.GOODBYE:
            self._lose(peer, f"left: {clip(str(message.scalars[0]))}")
            if peer.role is Role.EXPERIMENT:
                self._send_off(peer.session)
        else:
            self._error(route, message, ErrorCode.NOT_ASKED, f"{kind.name} is for the hub to send")
        return False

    def malformed(self, route: Route, error: RemoteProtocolError, now: float) -> None:
        """Act on bytes from `route` that are no message: whoever sent them loses its place."""
        self._now = now
        if isinstance(error, UnknownKind):
            message = Message(Kind.ERROR, error.session, error.seq)
            self._error(route, message, ErrorCode.UNKNOWN_KIND, str(error))
            return
        self._error(route, Message(Kind.ERROR, "", 0), ErrorCode.MALFORMED, str(error))
        self.lose(route, f"sent a malformed message: {error}", now, ErrorCode.PEER_FAILED)

    def lose(self, route: Route, why: str, now: float, code: ErrorCode = ErrorCode.PEER_LOST) -> None:
        """Go on without whoever is reached by `route`; `why` completes a sentence about them."""
        self._now = now
        for peer in list(self._seats.get(route, {}).values()):
            self._lose(peer, why, code)

    def tick(self, now: float) -> None:
        """Send every peer a sign of life, and give up those that stayed out of reach too long."""
        self._now = now
        for route, seats in list(self._seats.items()):
            reached = self.send(route, Message(Kind.HEARTBEAT, "", 0))
            for peer in list(seats.values()):
                if not reached:
                    self._out_of_reach(peer)
                elif peer.unreachable_since is not None:
                    # Its connection holds, but its queue was full, and something was dropped.
                    peer.unreachable_since = None
                    peer.session.repeat(peer)
                since = peer.unreachable_since
                if since is not None and now - since >= self._config.patience:
                    self._lose(peer, f"was out of reach for {now - since:.1f} s")
        for session in self._sessions.values():
            session.report_if_slow(now)

    def close(self, reason: str) -> None:
        """Tell every peer that the hub ends."""
        for route, seats in self._seats.items():
            for session in seats:
                self.send(route, Message(Kind.GOODBYE, session, 0, (reason,)))
        self._seats.clear()
        self._sessions.clear()

    def _receive_from_stranger(self, route: Route, message: Message) -> None:
        if message.kind is not Kind.HELLO:
            text = f"no peer of session {message.session!r} is known by this connection; say HELLO first"
            self._error(route, message, ErrorCode.UNKNOWN_PEER, text)
            return
        refusal = self._greet(route, message)
        if refusal is not None:
            code, text = refusal
            self.log(f"refused a peer of session {message.session!r}: {text}")
            self.send(route, Message(Kind.REFUSE, message.session, message.seq, (str(code), clip(text))))

    def _greet(self, route: Route, message: Message) -> tuple[ErrorCode, str] | None:
        """Let the sender of a HELLO in, or return why not."""
        versions, role_name, instance, name, codec, capabilities = message.scalars
        assert isinstance(versions, tuple)
        assert isinstance(instance, bytes)
        assert isinstance(capabilities, tuple)
        assert isinstance(name, str)
        assert isinstance(codec, str)
        if PROTOCOL_VERSION not in versions:
            text = f"this hub speaks protocol version {PROTOCOL_VERSION}, the peer {list(versions)}"
            return ErrorCode.VERSION, text
        try:
            role = Role(str(role_name))
        except ValueError:
            return ErrorCode.MALFORMED, f"a role is {', '.join(Role)}, not {role_name!r:.40}"
        if len(instance) != INSTANCE_SIZE:
            return ErrorCode.MALFORMED, f"an instance is {INSTANCE_SIZE} bytes, not {len(instance)}"
        if not message.session or not message.session.isprintable():
            return ErrorCode.MALFORMED, "a session has a name of printable characters"
        if not route.admits(role, message.session):
            text = f"no {role} of session {message.session!r} can join at this address of the hub"
            return ErrorCode.NOT_ADMITTED, text
        seats = self._seats.get(route, {})
        if message.session not in seats and len(seats) >= self._config.max_seats:
            text = f"this connection takes part in {len(seats)} sessions, the maximum; open another one"
            return ErrorCode.FULL, text
        session = self._sessions.get(message.session)
        if session is None:
            if len(self._sessions) >= self._config.max_sessions:
                text = f"this hub serves {self._config.max_sessions} sessions at once, and all are in use"
                return ErrorCode.FULL, text
            session = self._sessions[message.session] = _Session(self, message.session)
        other = seats.get(message.session)
        if other is not None and other.role is not role:
            return ErrorCode.MALFORMED, f"this connection is the {other.role} of the session already"
        current = session.peers.get(role)
        if current is not None and current.instance != instance:
            if current.unreachable_since is None and self._reach(current):
                text = f"session {session.name!r} has an {role} already: {current.label}"
                return ErrorCode.ROLE_TAKEN, text
            self._lose(current, "was replaced by another")
            current = None
        known = session.knows(role, instance)
        # Over one connection nothing is lost: the sender has read, or will read, the WELCOME before this one.
        resumed = known or (current is not None and current.route == route)
        config = self._config
        welcome = (PROTOCOL_VERSION, resumed, config.heartbeat, config.patience, config.max_body)
        self.send(route, Message(Kind.WELCOME, session.name, message.seq, welcome))
        if current is not None:
            if current.route == route:
                # It has missed nothing. To send more again would let it fill the hub's memory.
                return None
            self._unseat(current)
        label = clip(f"{name} ({codec})", _MAX_LABEL)
        peer = _Peer(session, role, route, instance, label, frozenset(map(str, capabilities)), known)
        self._sessions[session.name] = session
        self._seats.setdefault(route, {})[session.name] = peer
        if current is None:
            self.log(f"session {session.name!r}: {role} {label} {'returned' if known else 'joined'}")
        session.join(peer, same=known or current is not None, announce=current is None)
        return None

    def end(self, session: _Session, why: str) -> None:
        """End a session: say goodbye to all its peers."""
        goodbye = Message(Kind.GOODBYE, session.name, 0, (clip(f"the session was ended: {why}"),))
        # The experiment first: without it nobody is told of the loss of the players.
        for role in (Role.EXPERIMENT, Role.AGENT, Role.ENVIRONMENT):
            peer = session.peers.get(role)
            if peer is not None:
                self._lose(peer, f"was sent off: {why}")
                self.send(peer.route, goodbye)

    def _send_off(self, session: _Session) -> None:
        """The run is over: say goodbye to those who came for one run."""
        for player in list(session.peers.values()):
            if ONE_RUN in player.capabilities:
                goodbye = Message(Kind.GOODBYE, session.name, 0, ("the experiment is over",))
                self.send(player.route, goodbye)
                self._lose(player, "was sent off: the experiment is over")

    def _unseat(self, peer: _Peer) -> None:
        seats = self._seats[peer.route]
        del seats[peer.session.name]
        if not seats:
            del self._seats[peer.route]

    def send(self, route: Route, message: Message) -> bool:
        """Send `message`; return False, having sent nothing, if the other side is gone or does not read."""
        return route.deliver(message)

    def _reach(self, peer: _Peer) -> bool:
        return self.send(peer.route, Message(Kind.HEARTBEAT, "", 0))

    def _lose(self, peer: _Peer, why: str, code: ErrorCode = ErrorCode.PEER_LOST) -> None:
        session = peer.session
        self._unseat(peer)
        self.log(f"session {session.name!r}: {peer.role} {peer.label} {why}")
        session.lose(peer, why, code)
        if not session.peers:
            self._sessions.pop(session.name, None)
            self.memory.hold(session, 0)

    def _out_of_reach(self, peer: _Peer) -> None:
        if peer.unreachable_since is None:
            peer.unreachable_since = self._now

    def _error(self, route: Route, message: Message, code: ErrorCode, text: str) -> None:
        self.send(route, Message(Kind.ERROR, message.session, message.seq, (str(code), clip(text))))

    def deliver(self, peer: _Peer, message: Message) -> None:
        """Send `message` to `peer`; if it is out of reach, its patience starts to run."""
        if not self.send(peer.route, message):
            self._out_of_reach(peer)


class _Session:
    """One experiment's engine and its players."""

    __slots__ = (
        "_board",
        "_confirmed",
        "_engine",
        "_heavy",
        "_outstanding",
        "_reply",
        "_request_seq",
        "_seq",
        "_slow_after",
        "_watched",
        "_watched_since",
        "name",
        "peers",
    )

    def __init__(self, board: Switchboard, name: str) -> None:
        self.name = name
        self.peers: dict[Role, _Peer] = {}
        self._board = board
        self._engine = Engine(Action().body)
        self._confirmed: dict[Role, bytes] = {}
        self._seq = 0
        self._outstanding: Message | None = None
        self._request_seq = 0
        self._reply: Message | None = None
        self._watched: Message | None = None
        self._watched_since = 0.0
        self._slow_after = _SLOW_SECONDS
        self._heavy = False

    @property
    def num_steps(self) -> int:
        """What RL_num_steps is at present."""
        return self._engine.num_steps

    @property
    def seated(self) -> bool:
        """Whether anybody takes part."""
        return True

    def evict(self, why: str) -> None:
        """End the session: it keeps too much."""
        self._board.end(self, why)

    def _weigh(self) -> None:
        """Account for the bodies that are kept; those of a session with small ones alone do not count."""
        engine, call, reply = self._engine, self._outstanding, self._reply
        bodies = (call and call.body, reply and reply.body, engine.last_action, engine.task_spec)
        size = sum(len(body) for body in bodies if body)
        self._heavy = size > _LIGHT
        self._board.memory.hold(self, size if self._heavy else 0)

    def knows(self, role: Role, instance: bytes) -> bool:
        """Return whether `instance` is, or was last, in that role, and has sent a request or an answer.

        Before that nobody can tell whether it has read its first WELCOME, which says that it has to forget
        whatever it did at another hub: that WELCOME may have been lost with its connection.
        """
        return instance == self._confirmed.get(role)

    def _confirm(self, peer: _Peer) -> None:
        """Note that `peer` has sent a request or an answer, so it has read that it was unknown before."""
        peer.confirmed = True
        self._confirmed[peer.role] = peer.instance

    def join(self, peer: _Peer, same: bool, announce: bool) -> None:
        """Take `peer` in, and send it whatever waits for it.

        `same` says that it goes on in its role, over a new connection or after it was lost; `announce`,
        that the role was empty.
        """
        role = peer.role
        if not same:
            self._confirmed.pop(role, None)
        self.peers[role] = peer
        if role is Role.EXPERIMENT:
            for player in self.peers.values():
                if player is not peer:
                    self._notify(Event.JOINED, player.role, player.label)
            if same:
                self.repeat(peer)
            else:
                self._forget_experiment()
            return
        if announce:
            self._notify(Event.RETURNED if same else Event.JOINED, role, peer.label)
        if not same:
            self._engine.replace(role)
        asked = self._engine.asked
        if asked is None or CALLS[asked.kind].callee is not role:
            return
        if announce:
            # It was asked of an empty seat: nobody has seen it, and what to ask depends on who came.
            self._call(asked)
        else:
            self.repeat(peer)

    def repeat(self, peer: _Peer) -> None:
        """Send again what `peer` may have missed; whatever it has seen already, it ignores."""
        missed = self._reply if peer.role is Role.EXPERIMENT else self._outstanding
        if missed is not None and (peer.role is Role.EXPERIMENT or CALLS[missed.kind].callee is peer.role):
            self._board.deliver(peer, missed)

    def lose(self, peer: _Peer, why: str, code: ErrorCode) -> None:
        """Go on without `peer`: void the episode, or, without the experiment, forget it."""
        role = peer.role
        del self.peers[role]
        if role is Role.EXPERIMENT:
            self._forget_experiment()
            return
        engine = self._engine
        self._notify(Event.LOST, role, peer.label)
        awaited = engine.awaiting is not None and CALLS[engine.awaiting].callee is role
        reason = f"the {role} {peer.label} {why}"
        stranded = engine.verb is not None and (engine.in_episode or awaited)
        engine.void(reason)
        if stranded:
            self._fail(code, reason)

    def report_if_slow(self, now: float) -> None:
        """Mention, now and then, a player that has been asked and has not answered."""
        asked = self._outstanding
        role = None if asked is None else CALLS[asked.kind].callee
        player = None if role is None else self.peers.get(role)
        if asked is None or player is None:
            self._watched = None
        elif asked is not self._watched:
            self._watched, self._watched_since, self._slow_after = asked, now, _SLOW_SECONDS
        elif now - self._watched_since >= self._slow_after:
            text = f"{player.label} has not answered {asked.kind.name.lower()} for {self._slow_after:.0f} s"
            self._slow_after *= _RARER
            self._board.log(f"session {self.name!r}: {player.role} {text}")
            self._notify(Event.SLOW, player.role, text)

    def request(self, peer: _Peer, message: Message) -> bool:
        """Begin on a verb of the experiment; return whether it was in turn."""
        if message.seq <= self._request_seq:
            if message.seq != self._request_seq or message.seq == 0:
                text = f"a request {message.seq} came after {self._request_seq}; sequence numbers grow from 1"
                self._error(peer, message, ErrorCode.NOT_ASKED, text)
            # Otherwise it was heard; if its reply was missed, the HELLO of the new connection brought it.
            return False
        engine = self._engine
        if engine.verb is not None:
            text = f"{message.kind.name} came while {engine.verb.name} is still being carried out"
            self._error(peer, message, ErrorCode.BUSY, text)
            return False
        if message.kind not in CALLS or CALLS[message.kind].callee is not None:
            text = f"{message.kind.name} is not for an experiment to send"
            self._error(peer, message, ErrorCode.NOT_ASKED, text)
            return False
        if not peer.confirmed:
            self._confirm(peer)
        self._request_seq = message.seq
        self._reply = None
        try:
            instruction = engine.begin(message.kind, message.scalars, message.body)
        except PeerLost as error:
            self._fail(ErrorCode.PEER_LOST, str(error))
            return True
        self._advance(instruction)
        return True

    def answer(self, peer: _Peer, message: Message) -> bool:
        """Take an answer to the outstanding call, and make the next one; return whether it was in turn."""
        outstanding = self._outstanding
        seq = message.seq
        if outstanding is None or seq != outstanding.seq or CALLS[outstanding.kind].callee is not peer.role:
            # An answer to an older call is a repetition, or comes from an episode that is void by now.
            never = seq > self._seq or seq == 0
            if never or (message.kind in CALLS and CALLS[message.kind].callee is not peer.role):
                text = f"{message.kind.name} {seq} was never asked of this {peer.role}"
                self._error(peer, message, ErrorCode.NOT_ASKED, text)
            return False
        if not peer.confirmed:
            self._confirm(peer)
        if message.kind is Kind.ERROR:
            text = clip(str(message.scalars[1]))
            what = outstanding.kind.name.lower()
            self._fail(ErrorCode.PEER_FAILED, f"{peer.role} {peer.label} raised in {what}: {text}")
            return True
        try:
            instruction = self._engine.resume(message.kind, message.scalars, message.body)
        except RemoteProtocolError as error:
            self._error(peer, message, ErrorCode.NOT_ASKED, str(error))
            self._fail(ErrorCode.PEER_FAILED, f"{peer.role} {peer.label} broke the protocol: {error}")
            return True
        self._advance(instruction)
        return True

    def _advance(self, instruction: Instruction) -> None:
        """Make the call that the engine asks for, or send the experiment its reply."""
        kind, scalars, body = instruction
        if CALLS[kind].callee is not None:
            self._call(instruction)
            return
        self._outstanding = None
        if type(body) is tuple:
            body = body[0] + body[1]
        self._answer_experiment(Message(kind, self.name, self._request_seq, scalars, body or b""))

    def _call(self, instruction: Instruction) -> None:
        kind, scalars, body = instruction
        call = CALLS[kind]
        role = call.callee
        assert role is not None
        player = self.peers.get(role)
        offered = player is None or call.capability is None or call.capability in player.capabilities
        if player is not None and not offered:
            self._without_capability(kind, role, player)
            return
        self._seq += 1
        self._outstanding = outstanding = Message(kind, self.name, self._seq, scalars, body or b"")
        if self._heavy or len(outstanding.body) > _LIGHT:
            self._weigh()
            player = self.peers.get(role)
        if player is not None:
            self._board.deliver(player, outstanding)

    def _without_capability(self, kind: Kind, role: Role, player: _Peer) -> None:
        if skippable(kind):
            self._advance(self._engine.resume(kind, (), b""))
        else:
            self._fail(ErrorCode.UNSUPPORTED, unsupported(kind, role, player.label))

    def _fail(self, code: ErrorCode, text: str) -> None:
        """End the verb that is being carried out with an error."""
        self._engine.abort()
        self._outstanding = None
        self._answer_experiment(Message(Kind.ERROR, self.name, self._request_seq, (str(code), clip(text))))

    def _answer_experiment(self, reply: Message) -> None:
        self._reply = reply
        if self._heavy or len(reply.body) > _LIGHT:
            self._weigh()
        experiment = self.peers.get(Role.EXPERIMENT)
        if experiment is not None:
            self._board.deliver(experiment, reply)

    def _notify(self, event: Event, role: Role, text: str) -> None:
        experiment = self.peers.get(Role.EXPERIMENT)
        if experiment is not None:
            self._board.deliver(experiment, Message(Kind.NOTICE, self.name, 0, (str(event), str(role), text)))

    def _error(self, peer: _Peer, message: Message, code: ErrorCode, text: str) -> None:
        self._board.deliver(peer, Message(Kind.ERROR, self.name, message.seq, (str(code), clip(text))))

    def _forget_experiment(self) -> None:
        self._confirmed.pop(Role.EXPERIMENT, None)
        self._engine.abort()
        self._engine = Engine(Action().body)
        self._outstanding = None
        self._request_seq = 0
        self._reply = None
        if self._heavy:
            self._weigh()
