"""Entrants that are threads of the test, and a small competition for them."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from env_server.toys import MinesEnvironment
from experiment_runner.competition.launching import Launch, Launcher, Running
from experiment_runner.competition.match import Forfeited, Match, Piece, play
from experiment_runner.competition.settings import Competition, Entrant, Limits, Task
from experiment_runner.competition.trials import trials
from experiment_runner.executors.job import Ended, Recorded
from experiment_runner.store.records import EpisodeResult
from glue.client.players import serve_agent
from glue.errors import GlueError
from glue.roles import Agent
from glue.trajectory import Episode, TrajectoryReader
from glue.types import Action, Observation, Step

SECRET = b"nobody knows"


class Walker(Agent):
    """Plays mines by walking along a fixed path."""

    def __init__(self, path: tuple[int, ...] = (3, 3, 0, 3, 1, 2)) -> None:
        self.path = path
        self.steps = 0
        self.seeds: list[int] = []

    def agent_seed(self, seed: int) -> None:
        self.seeds.append(seed)

    def agent_init(self, task_spec: str) -> None:
        self.steps = 0  # also of a trial that starts over, whose program has not noticed

    def act(self) -> Action:
        self.steps += 1
        return Action(ints=[self.path[self.steps % len(self.path)]])

    def agent_start(self, observation: Observation) -> Action:
        return self.act()

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return self.act()


class Watched(MinesEnvironment):
    """Mines that says how many steps it has made, and whether its episode is over."""

    made = 0
    over = False

    def env_init(self) -> str:
        Watched.made = 0
        return super().env_init()

    def env_start(self) -> Observation:
        Watched.over = False
        return super().env_start()

    def env_step(self, action: Action) -> Step:
        step = super().env_step(action)
        Watched.over = step.terminal
        Watched.made += 1
        return step


class Dawdler(Walker):
    """Gives some answers only when the environment has made three steps without it, or its last."""

    def __init__(self, most: int) -> None:
        super().__init__()
        self.most = most  # steps of the task

    def agent_step(self, reward: float, observation: Observation) -> Action:
        until = min(Watched.made + 3, self.most)
        while self.steps % 4 == 2 and not Watched.over and Watched.made < until:
            time.sleep(0.001)
        return self.act()


class Thread(Running):
    """An agent that serves in a thread of the test."""

    def __init__(self, agent: Any, launch: Launch) -> None:
        super().__init__()
        self._agent = agent
        self._launch = launch
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        if self._agent is None:
            return
        with suppress(GlueError):
            serve_agent(self._agent, self._launch.hub, self._launch.session)

    def wait(self, seconds: float) -> bool:
        self._thread.join(min(seconds, 0.05))
        return False


class InThread(Launcher):
    """Starts an agent in a thread, which joins over its launch's socket; an agent of None never joins."""

    def __init__(self, agent: Any, running: Callable[[Any, Launch], Running] = Thread) -> None:
        self.agent = agent
        self.running = running
        self.launches: list[Launch] = []

    def start(self, entrant: Entrant, limits: Limits, launch: Launch) -> Running:
        self.launches.append(launch)
        return self.running(self.agent, launch)


def competition(*entrants: str, trials: int = 1, limits: Limits | None = None, **task: Any) -> Competition:
    """Return a competition of one task."""
    task = {"env": "mines", "steps": 40, **task}
    options = {"random_start": True} if task["env"] == "mines" else {}
    playing = tuple(Entrant(name, command=("nothing",)) for name in entrants)
    return Competition("test", trials, (Task("walk", options=options, **task),), playing, limits or Limits())


class Reports(list[Any]):
    """What a match has reported."""

    @property
    def forfeit(self) -> str:
        """The reason of its only forfeit, empty without one; nothing of ours has failed."""
        *reports, end = self
        assert end == Ended(None), self
        assert not any(isinstance(report, Forfeited) for report in reports[:-1])
        return str(reports[-1].reason) if isinstance(reports[-1], Forfeited) else ""

    @property
    def results(self) -> list[EpisodeResult]:
        return [report.result for report in self if isinstance(report, Recorded)]

    def episodes(self, folder: Path) -> list[Episode]:
        """Write its record into a folder; return the episodes in it."""
        path = folder / "record.traj"
        path.write_bytes(b"".join(report.data for report in self if isinstance(report, Piece)))
        return list(TrajectoryReader(path))


def reports_of(
    agent: Any, folder: Path, clock: Callable[[], float] | None = None, **settings: Any
) -> Reports:
    """Let an agent, or the entrant of a launcher, play one trial; return all reports."""
    held = competition("alice", **settings)
    (spec,) = trials(held, SECRET)
    match = Match(spec, held.entrants[0], held.limits, held.tasks[0].steps, folder / "log", "test")
    reports = Reports()
    launcher = agent if hasattr(agent, "sweep") else InThread(agent)
    play(match, reports.append, launcher, clock=clock or time.monotonic)
    return reports
