"""Judges of a simulated run: calls carried out twice, episodes void without a cause, memory, messages read,
moments shown, situations reached."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

from greenlet import getcurrent

from glue.client import players
from glue.client.answers import ServedPlayer
from glue.client.sockets import SocketTransport
from glue.engine.pacer import Pacer
from glue.hub.io import channels, inside
from glue.hub.io.log import Log, LogLevel
from glue.hub.io.server import Hub
from glue.hub.session import Session
from glue.hub.sessions import Sessions
from glue.wire.messages import CALLS, Event, Kind, Message, Role
from tests.simulation.order import Order
from tests.simulation.shown import MOMENTS, Shown
from tests.simulation.world import replacing
from tests.weighing import check

if TYPE_CHECKING:
    from tests.simulation.faults import Fault
    from tests.simulation.net import Socket
    from tests.simulation.run import Run
    from tests.simulation.world import Process

_NAMED: Final = {Kind.REFUSE, Kind.ERROR, Kind.NOTICE, Kind.WELCOME, Kind.GOODBYE}

_BEGIN: Final = {Kind.RL_INIT, Kind.RL_START, Kind.RL_EPISODE, Kind.RL_ENV_START}

_OF_EPISODES: Final = {
    *(_BEGIN - {Kind.RL_INIT}),
    *(Kind.RL_STEP, Kind.RL_ENV_STEP, Kind.RL_AGENT_START, Kind.RL_AGENT_STEP, Kind.RL_AGENT_END),
}
"""Requests that a void episode answers with an error."""

_CAUSES: Final = {
    "was unreachable": "a player was unreachable for the timeout",
    "was replaced": "a player was replaced while its connection was broken",
    "between two verbs": "a player was lost between two verbs",
    "it used": "a session or connection was evicted",
    "is void": "a verb of a void episode",
}

_LOGGED: Final = ("another", "unreachable", "newer connections", "it used", "is gone", "dismissed")

_ROLE: Final = re.compile(r"\b(?:agent|environment)\b")

_RECONNECT_SECONDS: Final = 1.2
"""Seconds that a connection may be missing after a break, with the longest delay before the next attempt."""


class Watch:
    """Watches one run.

    Attributes:
        seen: number of times that each situation occurred.
        lines: time, program and description of each event; empty unless requested.
        last: virtual time of the last trouble.
        calls: number of the last call that was carried out.
    """

    def __init__(self, run: Run, trace: bool) -> None:
        self._run = run
        self._trace = trace
        self.seen: Counter[str] = Counter()
        self.lines: list[Any] = []
        self.last = 0.0
        self.calls = 0
        self._hubs: dict[int, Hub] = {}
        self._incarnations: Counter[tuple[int, str]] = Counter()  # of a session, at a hub
        # The hub and incarnation of each WELCOME, by the hub's end of its connection, session and number; and
        # of the last WELCOME that a process has read in a session.
        self._welcomes: dict[tuple[int, str, int], tuple[int, int]] = {}
        self._welcomed: dict[tuple[int, str], tuple[int, int]] = {}
        self._carried: set[tuple[ServedPlayer, str, int, int, int]] = set()
        self._roles: dict[int, tuple[Role, tuple[str, ...]]] = {}
        self._troubles: list[tuple[float, float, int]] = []  # time, duration in seconds, process; 0 for all
        self._killed: list[tuple[float, int]] = []
        self._left: list[tuple[float, int]] = []
        # For sessions whose episode lost a player: the last request until then, and the first after it.
        self._void: dict[str, tuple[int, int]] = {}
        # For each session: losses of players, with the number of the first request that may know of each.
        self._losses: dict[str, list[tuple[int, Role]]] = {}
        self._told: list[Role] = []  # players whose loss an experiment was told of, since it returned
        self._deliveries = 0
        self.order = Order(run.problems.append)
        self._shown = Shown(run.problems.append)

    # Events that the run reports.

    def reached(self, name: str) -> None:
        """Count a situation."""
        self.seen[name] += 1

    def note(self, *what: Any) -> None:
        """Write a line of the trace."""
        if self._trace:
            self.lines.append((self._run.world.now, *what))

    def log(self, process: Process) -> Log:
        """Return the log of a hub."""
        watch = self

        class Noting(Log):
            def __call__(self, line: str, level: LogLevel = LogLevel.PEERS) -> None:
                watch.note(process.name, "log", line)
                for part in _LOGGED:
                    if part in line:
                        watch.reached(f"log: {part}")
                if level is LogLevel.ERROR and process.alive:
                    watch._run.problems.append(f"an error of the hub: {line}")

        return Noting(lambda line: None)

    def started(self, process: Process, hub: Hub) -> None:
        """Note that a hub listens."""
        self._hubs[process.number] = hub

    def player(self, process: Process, role: Role, sessions: list[str]) -> None:
        """Note that a player was started."""
        self._roles[process.number] = role, tuple(sessions)
        self.note(process.name, "started", process.number)

    def fault(self, fault: Fault, sender: Socket, data: bytes) -> None:
        """Note that a fault happens."""
        self.seen[f"fault: {fault.kind}"] += 1
        self.last = self._run.world.now
        peer = sender.peer
        self.note("fault", str(fault), f"{sender.process.name} -> {peer.process.name if peer else '?'}")

    def trouble(self, sender: Socket, seconds: float) -> None:
        """Note that a connection breaks, or is useless for a while."""
        for end in (sender, sender.peer):
            if end is not None:
                self._troubles.append((self._run.world.now, seconds, end.process.number))

    def stopped(self, process: Process | None, seconds: float) -> None:
        """Note that a program gets no core for a while; None for all of them."""
        hub = process is None or process.number in self._hubs
        number = 0 if process is None or hub else process.number
        self._troubles.append((self._run.world.now, seconds, number))

    def killed(self, process: Process) -> None:
        """Note that a program is killed."""
        self._killed.append((self._run.world.now, process.number))
        self.note(process.name, "killed", process.number)

    def leaves(self) -> None:
        """Note that the running program is about to leave all its sessions, or to harm them."""
        current: Any = getcurrent()
        self._left.append((self._run.world.now, current.process.number))

    # Judges.

    def void(self, session: Any, error: Exception, began: float) -> None:
        """Judge (c): an episode is void only if a player was lost in it."""
        text = str(error)
        self.note(f"experiment of {session.name}", "void", text)
        cause = next((name for part, name in _CAUSES.items() if part in text), None)
        self.reached(f"void: {cause or text[:60]}")
        now = self._run.world.now
        lost = _ROLE.search(text)  # the first role: a reason for leaving may name others
        role = Role(lost[0]) if lost else None
        timeout = self._run.timeout
        since = began - timeout - 10.0
        numbers = {
            number
            for number, (each, sessions) in self._roles.items()
            if session.name in sessions and (each is role or "between" in text)
        }
        if "broke the protocol" in text and numbers & self._run.liars.keys():
            return
        gone = [number for when, number in (*self._killed, *self._left) if when >= since]
        if any(number in numbers or number in self._hubs for number in gone):
            return
        if (
            cause is not None
            and ("replaced" in cause or "between" in cause)
            and len(numbers) > 1 + ("between" in cause)
        ):
            return
        if self._run.small and cause is not None and "evicted" in cause:
            return
        missing = sum(
            seconds + _RECONNECT_SECONDS
            for when, seconds, number in self._troubles
            if when + seconds >= since and number in {0, *numbers}
        )
        if cause is None or missing + self._run.heartbeat < timeout:
            self._run.problems.append(
                f"(c) session {session.name} is void without a loss, "
                f"{now - began:.3f} s after its beginning: {text}"
            )

    def _not_void(self, reply: Message) -> None:
        """Judge (c): an episode that has lost a player is not continued."""
        last = self._void.get(reply.session)
        if last is not None and reply.seq >= last[1]:
            self._run.problems.append(
                f"(c) session {reply.session} is not void, though a player was lost before {reply.kind.name} "
                f"{reply.seq}"
            )

    def _not_told(self, session: Session) -> None:
        """Judge (c): an experiment that returns is told of each loss of which it may not know."""
        missed = {role for first, role in self._losses.get(session.name, ()) if first >= session._request_seq}
        if missed - set(self._told):
            self._run.problems.append(
                f"(c) the experiment of {session.name} returned and was told of {self._told}, not of {missed}"
            )

    def closed(self, session: Any, error: Exception) -> None:
        """Judge the error that ended an experiment's session."""
        text = str(error)
        self.note(f"experiment of {session.name}", "closed", text)
        for part, name in (
            ("knows nothing", "experiment: forgotten by the hub"),
            ("times in succession", "experiment: gave up a request"),
            ("was ended", "experiment: its session was ended"),
        ):
            if part in text:
                self.reached(name)
                break
        else:
            self.reached(f"experiment closed: {text[:50]}")
        hubs = sum(1 for _, number in self._killed if number in self._hubs)
        if not hubs and not self._troubles and not self._killed and not self._run.small:
            self._run.problems.append(f"(c) session {session.name} was ended without a cause: {text}")

    def _carry_out(self, player: ServedPlayer, session: str, seq: int, kind: Kind) -> None:
        """Judge (a): a program carries out each call of a session once, until it leaves.

        A late call may be of a session that is over by now: it is of the one that the program knows.
        """
        current: Any = getcurrent()
        process: Process = current.process
        here = process.number, self._incarnations[process.number, session]
        key = (player, session, *self._welcomed.get((process.number, session), here), seq)
        self.note(process.name, "carries out", session, kind.name, seq)
        if key in self._carried:
            self._run.problems.append(f"(a) {process.name} carried out {kind.name} {seq} of {session} twice")
        self._carried.add(key)
        self.calls = seq

    def _memory(self, hub: Hub) -> None:
        """Judge (d): the hub's account of its memory is what its holders weigh, and within the limit."""
        try:
            check(hub)
        except AssertionError as error:
            self._run.problems.append(f"(d) {error}")
        total, limit = hub.sessions.memory.total, hub.config.max_memory
        if total > limit:
            self._run.problems.append(f"(d) a hub accounts for {total} bytes, more than {limit}")

    @contextmanager
    def entered(self) -> Iterator[None]:
        """Watch the hub and the players, while the body of the `with` runs."""
        watch = self

        class Counting(ServedPlayer):
            """A player whose calls are counted."""

            _now: Message

            def __init__(self, *given: Any) -> None:
                super().__init__(*given)
                for kind, (handler, read) in list(self._handlers.items()):
                    self._handlers[kind] = self._counted(kind, handler), read

            def _counted(self, kind: Kind, handler: Any) -> Any:
                def counted(scalars: Any, body: Any) -> Any:
                    watch._carry_out(self, self._now.session, self._now.seq, kind)
                    return handler(scalars, body)

                return counted

            def answer(self, message: Message) -> Message | None:
                last, kept = self._last_seq, self._last_call
                if message.seq == last:
                    watch.reached("player: repeated an answer")
                elif message == kept:
                    watch.reached("player: answered again what it had kept")
                self._now = message
                return super().answer(message)

        watched: list[tuple[Any, str, Callable[..., Any]]] = [
            (channels._SocketChannel, "deliver", self._deliver),
            (Sessions, "tick", self._tick),
            (Pacer, "due", self._due),
            (Sessions, "receive", self._receive),
            (Session, "__init__", self._open),
            (Session, "join", self._join),
            (Session, "lose", self._lose),
            (channels.Channels, "drop", self._drop),
            (SocketTransport, "send_message", self._send_message),
            (SocketTransport, "receive_message", self._receive_message),
        ]
        counting = [(module, "ServedPlayer", Counting) for module in (players, inside)]
        with replacing([*counting, *(_watched(*each) for each in watched)]):
            yield

    def _due(self, original: Any, pacer: Pacer) -> Any:
        self.reached("hub: a late action" if pacer.asked else "hub: an action in time")
        return original(pacer)

    def _deliver(self, original: Any, channel: Any, message: Message) -> bool:
        delivered: bool = original(channel, message)
        kind = message.kind
        self._deliveries += 1
        if delivered:
            end = channel.connection._socket
            self.order.sent(end, message)
            if kind is Kind.WELCOME:
                hub = end.process.number
                incarnation = self._incarnations[hub, message.session]
                self._welcomes[end.fd, message.session, message.seq] = hub, incarnation
            if kind in MOMENTS:
                self._shown.shown((channel, message.session), message)
            elif kind is Kind.WELCOME and not message.scalars[1]:
                self._shown.joined((channel, message.session))
        if kind is Kind.NOTICE and message.scalars[0] == Event.LOST:
            self._told.append(Role(str(message.scalars[1])))
        if kind in _OF_EPISODES:
            self._not_void(message)
        if kind in _NAMED:
            what = "" if kind is Kind.GOODBYE else f" {message.scalars[1 if kind is Kind.WELCOME else 0]!s}"
            self.seen[f"hub: {kind.name}{what}{'' if delivered else ' not delivered'}"] += 1
        elif not delivered:
            self.seen["hub: a message found its connection gone"] += 1
        if self._trace and kind is not Kind.HEARTBEAT:
            self.note("hub", "sends" if delivered else "cannot send", _peer_of(channel), message)
        return delivered

    def _tick(self, original: Any, sessions: Sessions, now: float) -> None:
        original(sessions, now)
        for hub in self._hubs.values():
            if hub.sessions is sessions:
                self._memory(hub)

    def _receive(self, original: Any, sessions: Sessions, channel: Any, message: Message, now: float) -> bool:
        if self._trace and message.kind is not Kind.HEARTBEAT:
            self.note("hub", "receives", _peer_of(channel), message)
        if message.kind in _BEGIN and message.seq > self._void.get(message.session, (message.seq, 0))[0]:
            del self._void[message.session]
        if isinstance(channel, channels._SocketChannel):
            self.order.read(channel.connection._socket, message)  # type: ignore[arg-type]
        if message.kind is Kind.OBSERVE:
            self._shown.wanted((channel, message.session), message.scalars[0])
        member = message.kind is Kind.HELLO and message.session in sessions._joined.get(channel, {})
        before = self._deliveries
        result: bool = original(sessions, channel, message, now)
        if member and self._deliveries > before + 1:
            self._run.problems.append(f"(f) {_peer_of(channel)} joined {message.session} twice")
        return result

    def _send_message(self, original: Any, transport: Any, message: Message) -> bool:
        current: Any = getcurrent()
        if transport.connected and current.process.number not in self._run.liars:
            self.order.sent(transport._socket, message)
        sent: bool = original(transport, message)
        return sent

    def _receive_message(self, original: Any, transport: Any, max_body: int) -> Message | None:
        message: Message | None = original(transport, max_body)
        if message is not None:
            end = transport._socket
            self.order.read(end, message)
            if message.kind is Kind.WELCOME:
                welcome = self._welcomes[end.peer.fd, message.session, message.seq]
                self._welcomed[end.process.number, message.session] = welcome
            elif message.kind in (Kind.GOODBYE, Kind.REFUSE):
                self.leaves()
        return message

    def _open(self, original: Any, session: Session, sessions: Any, name: str, *more: Any) -> None:
        original(session, sessions, name, *more)
        current: Any = getcurrent()
        self._incarnations[current.process.number, name] += 1
        self._void.pop(name, None)
        self._losses.pop(name, None)

    def _join(self, original: Any, session: Session, peer: Any, same: bool, announce: bool) -> None:
        if not same and peer.role is Role.EXPERIMENT:
            self._void.pop(session.name, None)
            self._losses.pop(session.name, None)
        if same and peer.role is Role.EXPERIMENT:
            self.seen[f"hub: an experiment returned, {'a' if session._reply else 'no'} reply to repeat"] += 1
        elif same:
            asked = session._engine.asked
            its = asked is not None and CALLS[asked.kind].callee is peer.role
            self.seen[f"hub: a player returned, {'a' if its else 'no'} call outstanding"] += 1
        self._told.clear()
        original(session, peer, same, announce)
        if peer.role is Role.EXPERIMENT:
            self._not_told(session)

    def _lose(self, original: Any, session: Session, peer: Any, why: str, code: Any) -> None:
        engine = session._engine
        when = "in an episode" if engine.in_episode else "in a verb" if engine.verb else "between verbs"
        self.seen[f"hub: lost an {peer.role} {when}"] += 1
        self.note("hub", "loses", f"{peer.role} of {session.name}", why)
        last = session._request_seq
        first = last + (session._reply is not None)
        if peer.role in (Role.AGENT, Role.ENVIRONMENT):
            self._losses.setdefault(session.name, []).append((first, peer.role))
            if engine.in_episode:
                self._void[session.name] = last, first
        original(session, peer, why, code)

    def _drop(self, original: Any, every: Any, channel: Any, why: str | None) -> None:
        where = "in a session" if channel.in_session else "without a session"
        self.seen[f"hub: dropped a connection {where}{' for ' + why[:24] if why else ''}"] += 1
        original(every, channel, why)


def _watched(owner: Any, name: str, watching: Callable[..., Any]) -> tuple[Any, str, Any]:
    """Return an attribute and the function in its place, which hands `watching` the original first."""
    original = getattr(owner, name)
    return owner, name, lambda *given, **named: watching(original, *given, **named)


def _peer_of(channel: Any) -> str:
    """Return the name of the program at the other end of a connection of the hub."""
    connection = getattr(channel, "connection", None)
    peer = None if connection is None else connection._socket.peer
    return "inside" if peer is None else str(peer.process.name)
