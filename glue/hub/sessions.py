"""The hub without its sockets: the members of sessions, and the consequences of losing a member.

A `Sessions` takes messages and the time, and hands messages to the channels of the peers.

- A peer identifies itself, in its HELLO, by a random number: its instance. The same instance over a new
  connection is the same peer, and continues where it was (see `glue.hub.session`). Until an instance has
  sent a request or an answer, every WELCOME says that it is unknown: an earlier WELCOME may have been lost.
- A peer is lost when it is unreachable for longer than the hub's timeout, or when another peer takes its role
  meanwhile.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

from glue.errors import RemoteProtocolError
from glue.hub.channel import Channel, Memory
from glue.hub.config import HubConfig
from glue.hub.observers import MAX_OBSERVERS
from glue.hub.session import Peer, Session
from glue.hub.timing import TimeBank
from glue.roles import CAPABILITIES
from glue.wire.codec import UnknownKind, clip
from glue.wire.messages import (
    BESIDE,
    CALL_KINDS,
    OUTCOME,
    PACE,
    PROTOCOL_VERSION,
    ErrorCode,
    Event,
    Kind,
    Message,
    Role,
)

INSTANCE_SIZE: Final = 16
"""Size in bytes of the random number that identifies a peer across connections."""

ONE_RUN: Final = "one-run"
"""Capability of a player that takes part in a single run: it is dismissed when the experiment leaves."""

_KNOWN: Final = frozenset({ONE_RUN, OUTCOME, *CAPABILITIES})
"""The capabilities that matter here; a peer may offer others, which are not kept."""

_EXPERIMENT: Final = Role.EXPERIMENT

_MAX_LABEL: Final = 255
"""Maximum number of bytes kept of a peer's name and codec."""


class Sessions:
    """All sessions of a hub.

    Args:
        config: limits and times.
        log: called with one line for people about each peer that joins, leaves or is slow to answer.
        clock: returns seconds, to measure the time of agents if `config` limits it; by default the time of
            the last message or tick.
        at: calls a function, with the time, when a time has come; needed if `config` has a pace.
        processor: as of `TimeBank`, of the agent of every session.

    Attributes:
        at: as given.
        now: the time of the last message or tick, or at which something was due.
        memory: bounds the memory of sessions, and of everything else that the hub keeps.
    """

    def __init__(
        self,
        config: HubConfig,
        log: Callable[[str], None],
        clock: Callable[[], float] | None = None,
        at: Callable[[float, Callable[[float], None]], None] = lambda time, work: None,
        processor: Callable[[], float | None] | None = None,
    ) -> None:
        self.memory: Memory = Memory(config.max_memory)
        self._config = config
        self.log = log
        self.at = at
        self.now: float = 0.0
        self._clock = clock or (lambda: self.now)
        self._processor = processor
        self._by_name: dict[str, Session] = {}
        self._joined: dict[Channel, dict[str, Peer]] = {}
        """The peers of each connection, by session."""
        self._left: Callable[[Channel, str], None] = lambda channel, session: None

    def on_leave(self, left: Callable[[Channel, str], None]) -> None:
        """Call `left` with the channel and the session whenever a channel leaves a session."""
        self._left = left

    def num_sessions(self, channel: Channel) -> int:
        """Return the number of sessions in which a channel takes part."""
        joined = self._joined.get(channel)
        return 0 if joined is None else len(joined)

    def num_steps(self, session: str) -> int:
        """Return the current RL_num_steps of a session that has a peer."""
        return self._by_name[session].num_steps

    def num_late(self, session: str) -> int:
        """Return the number of late actions since the last start in a session that has a peer."""
        return self._by_name[session].num_late

    def time_left(self, session: str) -> tuple[float, float] | None:
        """Return `TimeBank.left` of a session's agent; None if its time is not limited, or it is gone."""
        found = self._by_name.get(session)
        return None if found is None or found.time is None else found.time.left

    def capabilities(self, session: str, role: Role) -> frozenset[str] | None:
        """Return the capabilities of a session's peer; None if there is no such peer."""
        found = self._by_name.get(session)
        peer = None if found is None else found.peers.get(role)
        return None if peer is None else peer.capabilities

    def receive(self, channel: Channel, message: Message, now: float) -> bool:
        """Act on a message from `channel`; return whether it was in turn.

        The answer to the outstanding call is in turn, and so is a request while none is being carried out.
        """
        self.now = now
        joined = self._joined.get(channel)
        kind = message[0]
        peer = None if joined is None else joined.get(message[1])
        if peer is not None and (kind in CALL_KINDS or kind is Kind.ERROR):
            if peer.role is _EXPERIMENT:
                return peer.session.request(peer, message)
            return peer.session.answer(peer, message)
        if peer is None or kind is Kind.HELLO:
            self._receive_unknown(channel, message)
        elif kind is Kind.HEARTBEAT:
            self.send(channel, Message(Kind.HEARTBEAT, message.session, message.seq))
        elif kind is Kind.NOTICE and message.scalars[0] == Event.SLOW:
            peer.session.explain(peer, message)
        elif kind is Kind.GOODBYE:
            self._lose(peer, f"left: {clip(str(message.scalars[0]))}")
            if peer.role is Role.EXPERIMENT:
                self._end_run(peer.session)
        elif kind is Kind.OBSERVE and peer.session.observers is not None and peer.role is Role.OBSERVER:
            moments: Any = message.scalars[0]
            peer.session.observers.want(channel, moments)
        else:
            text = f"{kind.name} is not for this {peer.role} to send"
            self._error(channel, message, ErrorCode.NOT_ASKED, text)
        return False

    def malformed(self, channel: Channel, error: RemoteProtocolError, now: float) -> None:
        """Act on bytes from `channel` that are not a message: their sender leaves its sessions.

        A message of an unknown kind, which may be of a newer protocol, is only answered with an ERROR.
        """
        self.now = now
        if isinstance(error, UnknownKind):
            message = Message(Kind.ERROR, error.session, error.seq)
            self._error(channel, message, ErrorCode.UNKNOWN_KIND, str(error))
            return
        self._error(channel, Message(Kind.ERROR, "", 0), ErrorCode.MALFORMED, str(error))
        self.lose(channel, f"sent a malformed message: {error}", now, ErrorCode.PEER_FAILED)

    def lose(self, channel: Channel, why: str, now: float, code: ErrorCode = ErrorCode.PEER_LOST) -> None:
        """Continue without the peers of `channel`; `why` completes a sentence about them."""
        self.now = now
        for peer in list(self._joined.get(channel, {}).values()):
            self._lose(peer, why, code)

    def tick(self, now: float) -> None:
        """Send every connection a heartbeat, and give up peers that have been unreachable for too long."""
        self.now = now
        for channel, joined in list(self._joined.items()):
            reached = self.send(channel, Message(Kind.HEARTBEAT, "", 0))
            for peer in list(joined.values()):
                if not reached:
                    self._mark_unreachable(peer)
                elif peer.unreachable_since is not None:
                    # Its connection is intact, but its queue was full and a message was dropped.
                    peer.unreachable_since = None
                    peer.session.repeat(peer)
                since = peer.unreachable_since
                if since is not None and now - since >= self._config.timeout:
                    self._lose(peer, f"was unreachable for {now - since:.1f} s")
        for session in list(self._by_name.values()):
            session.report_if_slow(now)
            session.enforce_time()
        self.memory.enforce()

    def close(self, reason: str) -> None:
        """Say goodbye to every peer, as the hub ends."""
        for channel, joined in self._joined.items():
            for session in joined:
                self.send(channel, Message(Kind.GOODBYE, session, 0, (reason,)))
        self._joined.clear()
        self._by_name.clear()

    def _receive_unknown(self, channel: Channel, message: Message) -> None:
        if message.kind is not Kind.HELLO:
            text = f"this connection has not joined session {message.session!r}; say HELLO first"
            self._error(channel, message, ErrorCode.UNKNOWN_PEER, text)
            return
        refusal = self._greet(channel, message)
        if refusal is not None:
            code, text = refusal
            self.log(f"refused a peer of session {message.session!r}: {text}")
            self.send(channel, Message(Kind.REFUSE, message.session, message.seq, (str(code), clip(text))))

    def _greet(self, channel: Channel, message: Message) -> tuple[ErrorCode, str] | None:
        """Admit the sender of a HELLO, or return why not."""
        hello: Any = message.scalars  # of the types that the codec has checked
        versions, role_name, instance, name, codec, _ = hello
        if PROTOCOL_VERSION not in versions:
            text = f"this hub supports protocol version {PROTOCOL_VERSION}, the peer {list(versions)}"
            return ErrorCode.VERSION, text
        try:
            role = Role(role_name)
        except ValueError:
            return ErrorCode.MALFORMED, f"the role must be one of {', '.join(Role)}, not {role_name!r:.40}"
        if len(instance) != INSTANCE_SIZE:
            return ErrorCode.MALFORMED, f"an instance must have {INSTANCE_SIZE} bytes, not {len(instance)}"
        if not message.session or not message.session.isprintable():
            text = "the name of a session must have printable characters, and at least one"
            return ErrorCode.MALFORMED, text
        if not channel.admits(role, message.session):
            text = (
                f"no {role} of session {message.session!r} may join at this address of the hub, or with this "
                "key: ask its operator"
            )
            return ErrorCode.NOT_ADMITTED, text
        joined = self._joined.get(channel, {})
        if message.session not in joined and len(joined) >= self._config.max_joined:
            text = f"this connection takes part in {len(joined)} sessions, the maximum; open another one"
            return ErrorCode.FULL, text
        other = joined.get(message.session)
        if other is not None and other.role is not role:
            return ErrorCode.MALFORMED, f"this connection is already the {other.role} of the session"
        if role is Role.OBSERVER:
            return self._greet_observer(channel, message, instance, name, codec)
        session = self._by_name.get(message.session)
        if session is None:
            if len(self._by_name) >= self._config.max_sessions:
                text = f"this hub serves {self._config.max_sessions} sessions at once, and all are in use"
                return ErrorCode.FULL, text
            limits = self._config.time
            bank = None if limits is None else TimeBank(limits, self._clock, self._processor)
            session = Session(self, message.session, bank, self._config.pace)
            self._by_name[message.session] = session
        current = session.peers.get(role)
        if current is not None and current.instance != instance:
            if current.unreachable_since is None and self._reach(current):
                text = f"session {session.name!r} already has an {role}: {current.label}"
                return ErrorCode.ROLE_TAKEN, text
            self._lose(current, "was replaced by another")
            current = None
        known = session.knows(role, instance)
        # Over one connection nothing is lost: the sender has read, or will read, the previous WELCOME.
        resumed = known or (current is not None and current.channel == channel)
        self._welcome(channel, message, resumed)
        if current is not None:
            if current.channel == channel:
                # It has missed nothing. Sending more again would let it fill the hub's memory.
                return None
            self._remove(current)
        peer = Peer(session, role, channel, instance, *_named(name, codec), _offered(message), known)
        self._by_name[session.name] = session
        self._joined.setdefault(channel, {})[session.name] = peer
        if current is None:
            self.log(f"session {session.name!r}: {role} {peer.label} {'returned' if known else 'joined'}")
        session.join(peer, same=known or current is not None, announce=current is None)
        return None

    def _welcome(self, channel: Channel, message: Message, resumed: bool) -> None:
        config = self._config
        paced = config.pace and message.scalars[1] in (Role.EXPERIMENT, Role.ENVIRONMENT)
        holds = sorted(_offered(message) & (BESIDE | {PACE} if paced else BESIDE))
        confirmed = (tuple(holds),) if holds else ()
        numbers = config.heartbeat, config.timeout, config.max_body
        welcome = (PROTOCOL_VERSION, resumed, *numbers, *confirmed)
        self.send(channel, Message(Kind.WELCOME, message.session, message.seq, welcome))

    def _greet_observer(
        self, channel: Channel, message: Message, instance: bytes, name: str, codec: str
    ) -> tuple[ErrorCode, str] | None:
        """Admit the sender of a HELLO as an observer, which opens no session, or return why not."""
        session = self._by_name.get(message.session)
        if session is None:
            return ErrorCode.NO_SESSION, f"there is no session {message.session!r} yet; say HELLO again later"
        if message.session in self._joined.get(channel, {}):
            self._welcome(channel, message, resumed=True)
            return None
        others = self._observers(session)
        if len(others) >= MAX_OBSERVERS:
            gone = [other for other in others if not self._reach(other)]
            if not gone:
                return ErrorCode.FULL, f"session {session.name!r} has {MAX_OBSERVERS} observers, the maximum"
            for other in gone:
                self._lose(other, "is gone")
        peer = Peer(
            session, Role.OBSERVER, channel, instance, *_named(name, codec), _offered(message), confirmed=True
        )
        self._joined.setdefault(channel, {})[session.name] = peer
        self.log(f"session {session.name!r}: observer {peer.label} joined")
        self._welcome(channel, message, resumed=False)
        session.observe(peer)
        return None

    def _observers(self, session: Session) -> list[Peer]:
        channels = session.observers.channels if session.observers is not None else []
        return [self._joined[channel][session.name] for channel in channels]

    def end(self, session: Session, why: str) -> None:
        """End a session: say goodbye to all its peers."""
        goodbye = Message(Kind.GOODBYE, session.name, 0, (clip(f"the session was ended: {why}"),))
        # The experiment first: with it gone, no notices of the players' loss are sent.
        for role in (Role.EXPERIMENT, Role.AGENT, Role.ENVIRONMENT):
            peer = session.peers.get(role)
            if peer is not None:
                self._lose(peer, f"was dismissed: {why}")
                self.send(peer.channel, goodbye)

    def dismiss(self, player: Peer, why: str) -> None:
        """Say goodbye to a failed player, and continue without it; `why` completes a sentence about it."""
        self.send(player.channel, Message(Kind.GOODBYE, player.session.name, 0, (clip(f"it {why}"),)))
        self._lose(player, why, ErrorCode.PEER_FAILED)

    def _end_run(self, session: Session) -> None:
        """Say goodbye to the players that take part in a single run, which is over."""
        for player in list(session.peers.values()):
            if ONE_RUN in player.capabilities:
                goodbye = Message(Kind.GOODBYE, session.name, 0, ("the experiment is over",))
                self.send(player.channel, goodbye)
                self._lose(player, "was dismissed: the experiment is over")

    def _remove(self, peer: Peer) -> None:
        joined = self._joined[peer.channel]
        del joined[peer.session.name]
        if not joined:
            del self._joined[peer.channel]
        self._left(peer.channel, peer.session.name)

    def send(self, channel: Channel, message: Message) -> bool:
        """Send `message`; return False, having sent nothing, if the other side is gone or does not read."""
        return channel.deliver(message)

    def _reach(self, peer: Peer) -> bool:
        return self.send(peer.channel, Message(Kind.HEARTBEAT, "", 0))

    def _lose(self, peer: Peer, why: str, code: ErrorCode = ErrorCode.PEER_LOST) -> None:
        session = peer.session
        self._remove(peer)
        self.log(f"session {session.name!r}: {peer.role} {peer.label} {why}")
        session.lose(peer, why, code)
        if not session.peers and peer.role is not Role.OBSERVER:
            self._by_name.pop(session.name, None)
            self.memory.account(session, 0)
            for observer in self._observers(session):
                self.send(observer.channel, Message(Kind.GOODBYE, session.name, 0, ("the session is over",)))
                self._lose(observer, "was dismissed: the session is over")

    def _error(self, channel: Channel, message: Message, code: ErrorCode, text: str) -> None:
        self.send(channel, Message(Kind.ERROR, message.session, message.seq, (str(code), clip(text))))

    def deliver(self, peer: Peer, message: Message) -> None:
        """Send `message` to `peer`; start its timeout if it cannot be reached."""
        if not peer.channel.deliver(message):
            self._mark_unreachable(peer)

    def _mark_unreachable(self, peer: Peer) -> None:
        if peer.unreachable_since is None:
            peer.unreachable_since = self.now


def _offered(hello: Message) -> frozenset[str]:
    """Return the capabilities of a HELLO that matter here."""
    capabilities: Any = hello.scalars[-1]
    return _KNOWN.intersection(map(str, capabilities))


def _named(name: str, codec: str) -> tuple[str, str]:
    """Return the name of a peer for error messages, and its label for notices and the log."""
    return clip(name, _MAX_LABEL), clip(f"{name} ({codec})", _MAX_LABEL)
