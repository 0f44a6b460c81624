"""A season inside the process of a test: real matches and replays, the clock and the calendar in its hand."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any, Self

import pytest

from experiment_runner.competition.course import Course, course_of
from experiment_runner.competition.match import NOT_CONNECTED, Match, play
from experiment_runner.competition.organiser import open_competition
from experiment_runner.competition.records.verify import judge
from experiment_runner.competition.season.control import Attempt, Enrol, Organise, Reply, Request
from experiment_runner.competition.season.server import Server
from experiment_runner.competition.settings import Competition, Gate, parse_competition
from experiment_runner.competition.state import State
from experiment_runner.competition.worker import Replay
from experiment_runner.executors.dispatcher import Dispatcher
from experiment_runner.executors.interrupts import Interrupts
from experiment_runner.executors.job import Ended
from experiment_runner.store.results import Results
from experiment_runner.store.store import Store
from glue.client.libzmq import new_pair
from glue.errors import ExperimentError
from glue.keys.certificates import encode, write_pair
from tests.experiment_runner.competition.players import InThread, Walker

SECRET = b"nobody knows"
CODE = "lemonade"
OPENS = datetime(2026, 12, 1, 9, tzinfo=UTC)

FILE = """\
name = "spring"
trials = 2
seed_env = "SECRET"
[season]
opens = 2026-12-01T08:00:00
closes = 2026-12-22T20:00:00
enrol = "code"
code_env = "CODE"
attempts_per_day = 3
parallel = 2
failures = 2
[tasks]
mines = { env = "mines", options = { random_start = true }, steps = 20, phase = "proving" }
"""


class Executor:
    """Plays and replays at once, in this process.

    Attributes:
        agents: of the entrants, by name; others walk. A text ends the trial with this failure; None never
            reports anything.
        jobs: those that have no end.
        played: ids of all trials that were played, in their order.
        awaited: ids of those whose entrant was waited for in vain.
    """

    size = 99

    def __init__(self) -> None:
        self.agents: dict[str, Any] = {}
        self.jobs: dict[str, Match] = {}
        self.played: list[str] = []
        self.awaited: list[str] = []
        self.gates: list[str] = []
        self._reports: list[tuple[str, Any]] = []

    def start(self, job: Any) -> None:
        reports: list[Any] = []
        if isinstance(job, Replay):
            with Results.open(job.directory) as results:
                verdict = judge(results, job.spec, job.outcome, job.steps)
            reports = [verdict, Ended(None)]
        else:
            agent = self.agents.get(job.entrant.name, Walker())
            self.played.append(job.spec.id)
            self.gates.append("" if job.gate is None else job.gate.bind)
            if agent is None:
                self.jobs[job.spec.id] = job
            elif isinstance(agent, str):
                reports = [Ended(agent)]
            else:  # the key is checked where there are sockets
                if agent is Absent and not job.absent:
                    self.awaited.append(job.spec.id)
                    job = replace(job, absent=f"{NOT_CONNECTED} 30 s")
                play(replace(job, entrant=replace(job.entrant, key=None)), reports.append, InThread(agent))
        self._reports += [(job.spec.id, report) for report in reports]

    def receive(self, seconds: float) -> list[tuple[str, Any]]:
        found, self._reports = self._reports, []
        return found

    def cancel(self, trial_id: str) -> None:
        self.jobs.pop(trial_id)

    def stop(self) -> None:
        pass

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass


class Absent(Walker):
    """Does not connect."""


class Raising(Walker):
    """Forfeits."""

    def agent_init(self, task_spec: str) -> None:
        raise ValueError("<b>no idea</b>")


@dataclass
class Season:
    """A season that a test serves, turn by turn."""

    folder: Path
    text: str = FILE
    today: datetime = OPENS
    seconds: float = 0.0
    executor: Executor = field(default_factory=Executor)
    said: list[str] = field(default_factory=list)
    stack: ExitStack = field(default_factory=ExitStack)

    def __post_init__(self) -> None:
        write_pair(self.folder / "keys", "hub", new_pair())
        self.start()

    @property
    def directory(self) -> Path:
        return self.folder / "run"

    @property
    def competition(self) -> Competition:
        return parse_competition(self.text, self.folder / "spring.toml")

    def start(self) -> None:
        """Start the server."""
        gate = Gate("tcp://127.0.0.1:4097", self.folder / "keys")
        self.store: Store = self.stack.enter_context(
            open_competition(self.directory, self.text, self.competition, SECRET)
        )
        self.server = self.stack.enter_context(
            Server(
                self.store,
                self.competition,
                SECRET,
                CODE,
                gate,
                self.said.append,
                now=lambda: self.today,
                clock=lambda: self.seconds,
            )
        )
        self.server.begin(Dispatcher(self.executor, self.server, self.stack.enter_context(Interrupts())))

    def restart(self) -> None:
        """Kill the server, and start another."""
        self.stack.close()
        self.executor.jobs.clear()
        self.start()

    def turns(self, count: int = 30) -> None:
        for _ in range(count):
            self.server.turn()

    def later(self, seconds: float, *asking: str) -> None:
        """Let time go by, in which some go on asking for their last attempts."""
        until = self.seconds + seconds
        while self.seconds < until:
            self.seconds += 5
            for name in asking:
                self.ask(Attempt(name, max(self.states(name))))
            self.turns(3)

    def days(self, count: float) -> None:
        self.today += timedelta(days=count)

    def ask(self, request: Request) -> Reply:
        return self.server.answer(request)

    def refuses(self, request: Request, why: str) -> ExperimentError:
        """Have the server refuse a request for this reason; return the refusal."""
        with pytest.raises(ExperimentError, match=why) as refused:
            self.ask(request)
        return refused.value

    def act(self, kind: str, subject: str = "", **more: Any) -> list[str]:
        found: list[str] = self.ask(Organise(kind, subject, **{"why": "because", **more}))["acts"]
        return found

    def enrol(self, *names: str) -> list[str]:
        """Let entrants enrol; return their tokens."""
        return [self.ask(Enrol(name, encode(new_pair().public), CODE))["token"] for name in names]

    def attempt(self, name: str, *agent: Any) -> int:
        """Let an entrant play an attempt, until it is over, from now on with another agent if there is one;
        return its number.
        """
        if agent:
            (self.executor.agents[name],) = agent
        number: int = self.ask(Attempt(name))["attempt"]
        self.turns()
        return number

    @property
    def course(self) -> Course:
        return course_of(self.directory)

    @property
    def state(self) -> State:
        return self.course.state

    def states(self, name: str) -> Mapping[int, str]:
        return {number: one.state for number, one in self.state.entrants[name].attempts.items()}
