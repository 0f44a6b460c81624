"""One session: an engine, up to three peers, and each step exactly once however often connections break.

- Every call carries a sequence number, and its answer repeats that number. An answer to any other call than
  the outstanding one changes nothing.
- When a known peer returns over a new connection, the outstanding call is sent again; a peer that has already
  answered it repeats its answer. Likewise, an experiment is sent its last reply again.
- When a player is lost, the episode under way is void, and the experiment is notified.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final, Protocol

from glue.engine.calls import skippable, unfit_for_batch, unsupported
from glue.engine.engine import Engine, Instruction
from glue.engine.pacer import Pacer
from glue.errors import PeerLost, RemoteProtocolError
from glue.hub.channel import Channel, Memory
from glue.hub.observers import Observers
from glue.hub.timing import SlowCalls, TimeBank
from glue.pace import Pace
from glue.types import BESIDE_AT, CUT_OFF, NOTHING_BESIDE, PREFIX_SIZE, Action
from glue.wire.beside import beside_without, readable, readable_by_agent
from glue.wire.codec import clip
from glue.wire.messages import CALLS, OUTCOME, PACE, ErrorCode, Event, Kind, Message, Role

_CALLEES: Final = {kind: call.callee for kind, call in CALLS.items()}
_ALWAYS: Final = frozenset(
    kind for kind, call in CALLS.items() if call.capability is None and kind is not Kind.AGENT_INIT
)
"""Calls that every player of the role accepts."""

# Bound once: looking up a member of an enum takes longer than comparing with it.
_ENV_STEP: Final = Kind.ENV_STEP
_AGENT_STEP: Final = Kind.AGENT_STEP
_ENV_START: Final = Kind.ENV_START
_AGENT_START: Final = Kind.AGENT_START
_ERROR: Final = Kind.ERROR
_RL_ENV_START: Final = Kind.RL_ENV_START
_RL_ENV_STEP: Final = Kind.RL_ENV_STEP
_RL_EPISODE: Final = Kind.RL_EPISODE

_message: Final = tuple.__new__
"""Constructor of a named tuple, at half the cost of calling its class."""


_LIGHT: Final = 2048
"""Maximum size of a body, in bytes, that a session keeps without accounting for it."""

_BODIES: Final = 7
"""Maximum number of bodies that a session keeps: those of the engine, a copy of the observation without what
the agent does not read, and a reply of two."""

_BASE: Final = 10_240 + _BODIES * _LIGHT
"""Bytes that a session uses at most besides larger bodies: its engine, the names of its peers, and texts."""

_PACED: Final = 4
"""Maximum number of bodies that a pacer keeps, besides delayed actions: two calls and two actions."""

_WAITING: Final = Pace()

_MAX_QUERIES: Final = 8
"""Maximum number of requests without a call, between two calls, that are in turn."""


@dataclass(slots=True, eq=False)
class Peer:
    """The program that fills a role, and the channel to it.

    `name` is its name in error messages; `label` adds its language and library, for notices and the log.
    """

    session: Session
    role: Role
    channel: Channel
    instance: bytes
    name: str
    label: str
    capabilities: frozenset[str]
    confirmed: bool
    unreachable_since: float | None = None


class Host(Protocol):
    """The hub's interface for sessions; see `glue.hub.sessions.Sessions`."""

    memory: Memory
    log: Callable[[str], None]
    now: float
    at: Callable[[float, Callable[[float], None]], None]

    def deliver(self, peer: Peer, message: Message) -> None:
        """Send `message` to `peer`, or note that the peer cannot be reached."""

    def end(self, session: Session, why: str) -> None:
        """End a session: say goodbye to all its peers."""

    def dismiss(self, player: Peer, why: str) -> None:
        """Say goodbye to a failed player, and continue without it; `why` completes a sentence about it."""


class Session:
    """One experiment's engine and its players.

    Args:
        host: the hub.
        name: the session's name.
        time: limits the time of the agent; None for no limit.
        pace: of the environment.
    """

    __slots__ = (
        "_base",
        "_confirmed",
        "_copied",
        "_due",
        "_engine",
        "_explained",
        "_heavy",
        "_host",
        "_lost",
        "_lost_since_reply",
        "_outstanding",
        "_paced",
        "_pacer",
        "_passed",
        "_queries",
        "_queries_after",
        "_reply",
        "_request_seq",
        "_seq",
        "_slow",
        "name",
        "observers",
        "peers",
        "time",
    )

    def __init__(self, host: Host, name: str, time: TimeBank | None = None, pace: Pace = _WAITING) -> None:
        self.name: str = name
        self.peers: dict[Role, Peer] = {}
        self.observers: Observers | None = None
        self._host = host
        self.time: TimeBank | None = time
        self._engine = Engine(Action().body)
        self._confirmed: dict[Role, bytes] = {}
        self._seq = 0
        self._explained = 0  # the last call whose delay a player has explained
        self._outstanding: Message | None = None
        late = None if pace.action is None else pace.action.body
        self._pacer = Pacer(pace, Action().body, late) if pace else None
        self._paced: Message | None = None  # with a pacer, the agent's outstanding call
        self._request_seq = 0
        self._reply: Message | None = None
        # Labels of lost players: from the reply before the last request to the reply to it, and since then.
        self._lost: dict[Role, str] = {}
        self._lost_since_reply: dict[Role, str] = {}
        self._slow = SlowCalls()
        self._copied = False  # the outstanding call has a copy of an observation, for the agent
        self._passed = NOTHING_BESIDE  # sizes of what may be sent beside an observation and is read whole
        self._heavy = False  # a body is not light
        self._due = False  # the size of the bodies that are kept has changed
        self._queries = 0  # number of requests without a call since the call `_queries_after`
        self._queries_after = 0
        self._base = _BASE + (0 if self._pacer is None else (pace.delay + _PACED) * _LIGHT)
        host.memory.account(self, self._base)

    @property
    def num_steps(self) -> int:
        """The current RL_num_steps."""
        return self._engine.num_steps

    @property
    def num_late(self) -> int:
        """The number of late actions since the last start."""
        return 0 if self._pacer is None else self._pacer.num_late

    @property
    def in_session(self) -> bool:
        """Always true: connections that take part in no session are evicted first."""
        return True

    def evict(self, why: str) -> None:
        """End the session, which uses too much memory."""
        self._host.end(self, why)

    def _account(self) -> None:
        """Account for the bodies that are kept."""
        engine = self._engine
        kept = engine.bodies
        if self._pacer is not None:
            kept += self._pacer.bodies
        if self._copied and self._outstanding is not None:
            kept += (self._outstanding.body,)
        if self._reply is not None:
            kept += (self._reply.body,)
        sizes = [*{id(body): len(body) for body in kept if body}.values()]  # some are kept in two places
        self._due = False
        self._heavy = max(sizes, default=0) > _LIGHT
        self._host.memory.account(self, self._base + sum(sizes) if self._heavy else self._base)

    def knows(self, role: Role, instance: bytes) -> bool:
        """Return whether `instance` was the last in that role, and has sent a request or an answer.

        Until then it may not have read its first WELCOME, which makes it forget its state at another hub:
        that WELCOME may have been lost with the connection.
        """
        return instance == self._confirmed.get(role)

    def _confirm(self, peer: Peer) -> None:
        """Note that `peer` has sent a request or an answer, so it has read its first WELCOME."""
        peer.confirmed = True
        self._confirmed[peer.role] = peer.instance

    def join(self, peer: Peer, same: bool, announce: bool) -> None:
        """Let `peer` take its role, and send it the messages that wait for it.

        Args:
            peer: the peer.
            same: whether it is the previous peer of the role, over a new connection or after it was lost.
            announce: whether the role was empty.

        An experiment that returns is notified again of lost players, in the original order: before the
        repeated reply, or after it.
        """
        role = peer.role
        self._passed = NOTHING_BESIDE
        self._account()  # it was given up if its only peer was replaced
        if not same:
            self._confirmed.pop(role, None)
        self.peers[role] = peer
        if role is Role.EXPERIMENT:
            if not same:
                self._forget_experiment()
            for role, label in self._lost.items():
                self._notify(Event.LOST, role, label)
            for player in self.peers.values():
                if player is not peer:
                    self._notify(Event.JOINED, player.role, player.label)
            self.repeat(peer)
            for role, label in self._lost_since_reply.items():
                self._notify(Event.LOST, role, label)
                if role in self.peers:
                    self._notify(Event.JOINED, role, self.peers[role].label)
            return
        if announce:
            self._notify(Event.RETURNED if same else Event.JOINED, role, peer.label)
        if not same:
            self._engine.replace(role)
        asked = self._engine.asked
        if announce and asked is not None and CALLS[asked.kind].callee is role:
            # The call was made while the role was empty: it was not sent, and may be another for this peer.
            self._advance(asked)
        elif not announce:
            self.repeat(peer)

    def repeat(self, peer: Peer) -> None:
        """Resend the message that `peer` may have missed; a peer ignores messages it has already received."""
        missed = self._reply if peer.role is Role.EXPERIMENT else self._awaited(peer.role)
        if missed is not None:
            self._host.deliver(peer, missed)

    def _awaited(self, role: Role) -> Message | None:
        """Return the outstanding call to a player."""
        asked = self._outstanding if self._pacer is None or role is Role.ENVIRONMENT else self._paced
        return asked if asked is not None and CALLS[asked.kind].callee is role else None

    def observe(self, peer: Peer) -> None:
        """Let `peer` observe."""
        if self.observers is None:
            self.observers = Observers(self.name, self._host.memory)
        self.observers.join(peer.channel, peer.capabilities, self._engine)

    def lose(self, peer: Peer, why: str, code: ErrorCode) -> None:
        """Remove `peer`: a lost player makes the episode void, a lost experiment is forgotten."""
        role = peer.role
        if self.observers is not None and role is Role.OBSERVER:
            self.observers.leave(peer.channel)
            if not self.observers.channels:
                self.observers = None
            return
        del self.peers[role]
        if role is Role.EXPERIMENT:
            self._forget_experiment()
            return
        engine = self._engine
        (self._lost if self._reply is None else self._lost_since_reply)[role] = peer.label
        self._notify(Event.LOST, role, peer.label)
        awaited = engine.awaiting is not None and CALLS[engine.awaiting].callee is role
        reason = f"the {role} {peer.name} {why}"
        stranded = engine.verb is not None and (engine.in_episode or awaited)
        engine.void(reason)
        if role is Role.AGENT:
            self._release_agent()
            if self._heavy:
                self._account()
        if stranded:
            self._fail(code, reason)

    def enforce_time(self) -> None:
        """Dismiss an agent that has run out of time without answering a call whose answer is still needed."""
        agent = self.peers.get(Role.AGENT)
        if self.time is None or agent is None or self._awaited(Role.AGENT) is None:
            return
        why = self.time.overdue()
        if why is not None:
            self._host.dismiss(agent, why)

    def report_if_slow(self, now: float) -> None:
        """Report, at growing intervals, a player that has not answered its call."""
        asked = self._paced or self._outstanding
        role = None if asked is None else CALLS[asked.kind].callee
        player = None if role is None else self.peers.get(role)
        explained = asked is not None and asked.seq == self._explained
        call = asked.seq if asked is not None and player is not None else None
        seconds = self._slow.overdue(call, now, explained)
        if player is not None and asked is not None and seconds is not None:
            text = f"{player.name} has not answered {asked.kind.name.lower()} for {seconds:.0f} s"
            self._host.log(f"session {self.name!r}: {player.role} {text}")
            self._notify(Event.SLOW, player.role, text)

    def explain(self, player: Peer, message: Message) -> None:
        """Pass on, once per call, why the player's answer will take long."""
        asked = self._awaited(player.role)
        if asked is None or asked.seq != message.seq or asked.seq == self._explained:
            return
        self._explained = asked.seq
        text = clip(f"{player.name}: {message.scalars[2]!s}")
        self._host.log(f"session {self.name!r}: {player.role} {text}")
        self._notify(Event.SLOW, player.role, text)

    def request(self, peer: Peer, message: Message) -> bool:
        """Begin a verb of the experiment; return whether it was in turn."""
        if message.seq <= self._request_seq:
            if message.seq != self._request_seq or message.seq == 0:
                text = (
                    f"request {message.seq} was received after {self._request_seq}; "
                    f"sequence numbers increase from 1"
                )
                self._error(peer, message, ErrorCode.NOT_ASKED, text)
            # Otherwise it is a repetition; a lost reply has been sent again after the HELLO.
            return False
        engine = self._engine
        if engine.verb is not None:
            text = f"{message.kind.name} was received while {engine.verb.name} is still being carried out"
            self._error(peer, message, ErrorCode.BUSY, text)
            return False
        if message.kind not in CALLS or CALLS[message.kind].callee is not None:
            text = f"an experiment must not send {message.kind.name}"
            self._error(peer, message, ErrorCode.NOT_ASKED, text)
            return False
        if not peer.confirmed:
            self._confirm(peer)
        self._request_seq = message.seq
        self._reply = None
        self._lost, self._lost_since_reply = self._lost_since_reply, {}
        if self._heavy or len(message.body) > _LIGHT:
            self._heavy = self._due = True
        try:
            instruction = engine.begin(message.kind, message.scalars, message.body)
        except PeerLost as error:
            self._fail(ErrorCode.PEER_LOST, str(error))
        else:
            self._advance(instruction)
        return self._outstanding is not None or self._may_query()

    def _may_query(self) -> bool:
        """Return whether a request that led to no call is in turn: a few are, after each call.

        Otherwise experiments without players could take the time of those that play.
        """
        if self._queries_after != self._seq:
            self._queries_after, self._queries = self._seq, 0
        self._queries += 1
        return self._queries <= _MAX_QUERIES

    def answer(self, peer: Peer, message: Message) -> bool:
        """Take an answer to the outstanding call, and make the next call; return whether it was in turn."""
        kind, _, seq, scalars, body = message
        outstanding = self._outstanding
        if outstanding is None or seq != outstanding[2] or _CALLEES[outstanding[0]] is not peer.role:
            outstanding = self._paced
            if outstanding is None or seq != outstanding.seq or peer.role is not Role.AGENT:
                self._answered_out_of_turn(peer, message)
                return False
        if not peer.confirmed:
            self._confirm(peer)
        if self.time is not None and peer.role is Role.AGENT and (why := self.time.answered()) is not None:
            self._host.dismiss(peer, why)
            return True
        if kind is _ERROR:
            text = clip(str(scalars[1]))
            what = outstanding.kind.name.lower()
            self._fail(ErrorCode.PEER_FAILED, f"{peer.role} {peer.name} raised in {what}: {text}")
            return True
        if kind is _ENV_STEP and scalars[1] == CUT_OFF and "truncate" not in peer.capabilities:
            scalars = (scalars[0], True)  # to an older environment every nonzero number is true
        if (kind is _ENV_STEP or kind is _ENV_START) and not body.startswith(self._passed, BESIDE_AT):
            unoffered = beside_without(body, peer.capabilities)
            if unoffered:
                text = f"it sent {unoffered} with {kind.name}, and does not offer the capability"
                self._error(peer, message, ErrorCode.UNSUPPORTED, text)
                self._fail(ErrorCode.PEER_FAILED, f"{peer.role} {peer.name} broke the protocol: {text}")
                return True
            agent = self.peers.get(Role.AGENT)
            if agent is not None and readable_by_agent(body, agent.capabilities) is body:
                self._passed = body[BESIDE_AT:PREFIX_SIZE]
        if self._heavy or len(body) > _LIGHT:
            self._replacing(kind, len(body))
        try:
            if outstanding is self._paced:
                assert self._pacer is not None
                due = self._pacer.answered(kind, scalars, body, self._host.now)
                self._ask_agent()
                if due is None:
                    return True
                scalars, body = due
                self._due = self._heavy
            instruction = self._engine.resume(kind, scalars, body)
        except RemoteProtocolError as error:
            self._error(peer, message, ErrorCode.NOT_ASKED, str(error))
            self._fail(ErrorCode.PEER_FAILED, f"{peer.role} {peer.name} broke the protocol: {error}")
            return True
        if self.observers is not None:
            self.observers.show(outstanding, scalars, body, self._engine)
        self._advance(instruction)
        return True

    def _replacing(self, kind: Kind, size: int) -> None:
        """Note that an answer will be kept; a step replaces the one before, usually of the same size."""
        engine = self._engine
        before = {_ENV_STEP: engine.observation, _AGENT_STEP: engine.last_action}.get(kind)
        self._heavy = True
        self._due = self._due or self._pacer is not None or not before or len(before) != size

    def _answered_out_of_turn(self, peer: Peer, message: Message) -> None:
        """Refuse an answer to a call that was never made; ignore a late or repeated answer.

        An answer to an older call is a repetition, or belongs to an episode that is now void. Both show that
        the player has been welcomed.
        """
        seq = message.seq
        never = seq > self._seq or seq == 0
        if never or _CALLEES.get(message.kind, peer.role) is not peer.role:
            text = f"{message.kind.name} {seq} was never sent to this {peer.role}"
            self._error(peer, message, ErrorCode.NOT_ASKED, text)
        elif not peer.confirmed:
            self._confirm(peer)

    def _advance(self, instruction: Instruction) -> None:
        """Make the call that the engine asks for, or send the experiment its reply."""
        kind, scalars, body = instruction
        role = _CALLEES[kind]
        if role is None:
            self._outstanding = None
            experiment = self.peers.get(Role.EXPERIMENT)
            reads = experiment.capabilities if experiment is not None else frozenset()
            if type(body) is tuple:
                body = readable(body[0], reads) + body[1]
            elif kind is _RL_ENV_STEP or kind is _RL_ENV_START:
                body = readable(body, reads)
            if kind is _RL_EPISODE and OUTCOME in reads:
                scalars += (self._engine.total_reward, self._engine.num_steps)
            if self._pacer is not None and kind is Kind.RL_NUM_STEPS and PACE in reads:
                scalars += (self._pacer.num_late,)
            reply = _message(Message, (kind, self.name, self._request_seq, scalars, body or b""))
            self._answer_experiment(reply)
            return
        player = self.peers.get(role)
        if player is not None and kind not in _ALWAYS:
            capability = CALLS[kind].capability
            if capability is not None and capability not in player.capabilities:
                self._without_capability(kind, role, player)
                return
            environment = self.peers.get(Role.ENVIRONMENT)
            games = environment.capabilities if environment is not None else ()
            if kind is Kind.AGENT_INIT:
                why = unfit_for_batch(games, player.capabilities, player.name, self._pacer is not None)
                if self._pacer is not None:
                    why = why or self._pacer.unfit(body.decode(errors="replace"))
                if why:
                    self._fail(ErrorCode.UNSUPPORTED, why)
                    return
        if (kind is _AGENT_STEP or kind is _AGENT_START) and not body.startswith(self._passed, BESIDE_AT):
            shown = readable_by_agent(body, player.capabilities if player is not None else ())
            self._copied = shown is not body
            self._due = self._due or (self._copied and self._heavy)
            body = shown
        elif self._copied:
            self._copied = False
            self._due = self._due or self._heavy
        if self._pacer is not None and role is Role.AGENT:
            self._outstanding = None
            if player is not None:  # or else the call is made when one joins
                self._pacer.call(Instruction(kind, scalars, body), self._host.now)
                self._ask_agent()
                if self._pacer.deadline is not None:
                    self._host.at(self._pacer.deadline, self._act)
            return
        self._seq += 1
        body = body or b""
        self._outstanding = outstanding = _message(Message, (kind, self.name, self._seq, scalars, body))
        if self._due:
            self._account()
        if player is not None:
            if self.time is not None and player.role is Role.AGENT:
                self.time.called(kind)
            self._host.deliver(player, outstanding)

    def _ask_agent(self) -> None:
        """Make the call to the agent whose turn it is, if it is free."""
        assert self._pacer is not None
        agent = self.peers[Role.AGENT]
        call = self._pacer.next_call(self._host.now, PACE in agent.capabilities)
        if self._pacer.asked is None:
            self._paced = None
        if self._due:
            self._account()
        if call is None:
            return
        self._seq += 1
        self._paced = _message(Message, (call.kind, self.name, self._seq, call.scalars, call.body or b""))
        if self.time is not None:
            self.time.called(call.kind)
        self._host.deliver(agent, self._paced)

    def _act(self, now: float) -> None:
        """Give the engine the action of the step that is due, unless that was forgotten since."""
        pacer = self._pacer
        if pacer is not None and pacer.deadline is not None and pacer.deadline <= now:
            self._host.now = now
            self._due = self._heavy
            self._advance(self._engine.resume(_AGENT_STEP, *pacer.due()))

    def _release_agent(self) -> None:
        """Expect no more answers to the agent's calls, if it has a pacer."""
        if self._pacer is not None:
            self._pacer.reset()
            self._paced = None

    def _without_capability(self, kind: Kind, role: Role, player: Peer) -> None:
        if skippable(kind):
            self._advance(self._engine.resume(kind, (), b""))
        else:
            self._fail(ErrorCode.UNSUPPORTED, unsupported(kind, role, player.name))

    def _fail(self, code: ErrorCode, text: str) -> None:
        self._engine.abort()
        self._release_agent()
        self._outstanding = None
        self._answer_experiment(Message(Kind.ERROR, self.name, self._request_seq, (str(code), clip(text))))

    def _answer_experiment(self, reply: Message) -> None:
        self._reply = reply
        if self._heavy or len(reply.body) > _LIGHT:  # an observation and an action together
            self._account()
        experiment = self.peers.get(Role.EXPERIMENT)
        if experiment is not None:
            self._host.deliver(experiment, reply)

    def _notify(self, event: Event, role: Role, text: str) -> None:
        experiment = self.peers.get(Role.EXPERIMENT)
        if experiment is not None:
            self._host.deliver(experiment, Message(Kind.NOTICE, self.name, 0, (str(event), str(role), text)))

    def _error(self, peer: Peer, message: Message, code: ErrorCode, text: str) -> None:
        self._host.deliver(peer, Message(Kind.ERROR, self.name, message.seq, (str(code), clip(text))))

    def _forget_experiment(self) -> None:
        self._confirmed.pop(Role.EXPERIMENT, None)
        self._engine.abort()
        self._release_agent()
        self._engine = Engine(Action().body)
        self._outstanding = None
        self._request_seq = 0
        self._reply = None
        self._lost, self._lost_since_reply = {}, {}
        if self._heavy:
            self._account()
