"""Recordings of simulated runs of one session, which TLC follows in docs/model/Glue.tla."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from random import Random
from typing import Any, Final, NamedTuple

from greenlet import getcurrent

from glue.client.answers import ServedPlayer
from glue.client.experiment import connect
from glue.errors import PeerLost
from glue.hub.session import Session
from glue.hub.sessions import Sessions
from glue.system import clock
from glue.wire.messages import Kind, Message, Role
from tests.players import ScriptedAgent, ScriptedEnvironment
from tests.simulation.faults import Fault
from tests.simulation.run import URL, Run
from tests.simulation.world import Process, replacing

KINDS: Final = ("break", "break", "close", "kill", "dribble", "late", "silence")


class Line(NamedTuple):
    """An event of a run, as the model names it."""

    event: str
    peer: str
    number: int
    instance: int
    busy: bool
    void: bool


class _TracedRun(Run):
    """A run of one session and three programs, whose events are recorded once RL_INIT is over."""

    def __init__(self, seed: int, faults: list[Fault]) -> None:
        super().__init__(seed, [], trace=False)
        self.faults = faults
        self.inside = self.keyed = self.several = self.joint = self.small = False
        self.sessions = self.sessions[:1]
        self.unsent = 2**26
        self.liar = None
        self.heartbeat, self.timeout = 1.0, 5.0
        self.calm_since = self.world.now
        session = self.sessions[0]
        session.slow = session.late = session.thinking = 0.0
        session.many = False
        self.events: list[Line] = []
        self.tracing = False
        self._instances: dict[tuple[str, bytes], int] = {}
        self._kills: Counter[str] = Counter()
        self._written: Counter[str] = Counter()
        self.calls = 0

    def note(
        self, event: str, peer: str, number: int = 0, instance: int = 0, of: Session | None = None
    ) -> None:
        """Record a line."""
        if self.tracing:
            # Messages of a killed program are read until another program of its role appears.
            kills = self._kills[peer] if event == "replace" else instance - 1
            for _ in range(self._written[peer], kills):
                self.events.append(Line("kill", peer, 0, 0, False, False))
                self._written[peer] += 1
            busy = of is not None and of._engine.verb is not None
            reply = None if of is None else of._reply
            void = reply is not None and reply.kind is Kind.ERROR
            self.events.append(Line(event, peer, number, instance, busy, void))

    def instance(self, role: str, instance: bytes) -> int:
        """Return the number of an instance: one more for each program of its role that was killed before."""
        known = self._instances
        if (role, instance) not in known:
            known[role, instance] = 1 + self._kills[role]
        return known[role, instance]

    def _experiment(self, session: Any) -> None:
        with connect(URL, session.name, wait=None) as glue:
            glue.rl_init()
            self.tracing = True
            self.calls = self.watch.calls
            base = self.net.sends
            self.plan = [fault._replace(at=fault.at + base) for fault in reversed(self.faults)]
            while self.plan or self.world.now < self.calm_since:
                if not self.plan:
                    clock.sleep(0.2)
                try:
                    glue.rl_episode(1)
                except PeerLost:
                    continue
            glue.rl_episode(1)
            self.tracing = False
            session.over = True

    def _player(self, role: Role, sessions: Any, delay: float) -> None:
        def start(kept: bool) -> Process:
            player: Any = ScriptedAgent() if role is Role.AGENT else ScriptedEnvironment()
            process = Process(self.world, str(role))
            process.spawn(partial(self._serve, role, {sessions[0].name: player}, 0.0))
            self.players.append((process, start))
            self.watch.player(process, role, [sessions[0].name])
            return process

        start(False)

    def _apply_elsewhere(self, fault: Fault) -> None:
        if fault.kind == "kill":
            alive = [process for process, _ in self.players if process.alive]
            if alive:
                name = alive[fault.which % len(alive)].name
                self._kills[name] += 1
        super()._apply_elsewhere(fault)


@contextmanager
def _noting(run: _TracedRun) -> Iterator[None]:
    """Record the hub's events while the body of the `with` runs."""

    def welcome(sessions: Sessions, channel: Any, message: Message, resumed: bool) -> None:
        _, role, instance, *_ = message.scalars
        number = run.instance(str(role), bytes(instance))  # type: ignore[arg-type]
        run.note("welcome", str(role), 0, number)
        before["_welcome"](sessions, channel, message, resumed)

    def lose(session: Session, peer: Any, why: str, code: Any) -> None:
        before["lose"](session, peer, why, code)
        run.note("replace" if "replaced" in why else "lost", str(peer.role), of=session)

    def request(session: Session, peer: Any, message: Message) -> bool:
        result: bool = before["request"](session, peer, message)
        run.note("request", "experiment", message.seq, of=session)
        return result

    def answer(session: Session, peer: Any, message: Message) -> bool:
        result: bool = before["answer"](session, peer, message)
        run.note("answer", str(peer.role), message.seq, of=session)
        return result

    def carry_out(player: ServedPlayer, session: str, seq: int, kind: Kind) -> None:
        current: Any = getcurrent()
        original(player, session, seq, kind)
        run.note("call", current.process.name, seq)

    changed: list[tuple[Any, str, Any]] = [
        (Sessions, "_welcome", welcome),
        (Session, "lose", lose),
        (Session, "request", request),
        (Session, "answer", answer),
    ]
    before = {name: getattr(owner, name) for owner, name, _ in changed}
    original = run.watch._carry_out
    run.watch._carry_out = carry_out  # type: ignore[method-assign]
    with replacing(changed):
        yield


def traced(seed: int) -> tuple[int, list[Line]]:
    """Return the number of the last call before a run's events, and the events."""
    random = Random(seed)
    at, faults = 0, []
    for _ in range(random.randint(1, 8)):
        at += random.randint(1, 25)
        kind = random.choice(KINDS)
        seconds = random.choice((0.001, 0.3, 7.0 if kind == "silence" else 0.6)) * random.random()
        faults.append(Fault(at, kind, random.randrange(2**31), seconds))
    run = _TracedRun(seed, faults)
    with _noting(run):
        run.go()
    assert not run.problems, run.problems
    return run.calls, run.events


def module(runs: list[tuple[int, list[Line]]]) -> str:
    """Return the module Simulated, which docs/model/Trace.tla reads."""
    written = ",\n".join("<<" + ",\n  ".join(map(_record, lines)) + ">>" for _, lines in runs)
    first = ", ".join(str(number) for number, _ in runs)
    bar = "-" * 20
    return f"{bar} MODULE Simulated {bar}\nRuns == <<\n{written}\n>>\n\nFirst == <<{first}>>\n{'=' * 60}\n"


def _record(line: Line) -> str:
    fields = (
        f'event |-> "{line.event}", peer |-> "{line.peer}", number |-> {line.number}, '
        f"instance |-> {line.instance}, busy |-> {str(line.busy).upper()}, void |-> {str(line.void).upper()}"
    )
    return f"[{fields}]"
