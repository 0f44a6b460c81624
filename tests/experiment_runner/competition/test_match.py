"""One trial of an entrant: its play, its record, and the reasons for which it may end early."""

from __future__ import annotations

import itertools
import threading
from pathlib import Path
from typing import Any

import pytest

from env_server.toys import MinesEnvironment
from experiment_runner.competition.launching import Launch
from experiment_runner.competition.match import ASK, Forfeited, Used
from experiment_runner.competition.records.verify import replay_trial
from experiment_runner.competition.settings import Limits
from experiment_runner.competition.trials import agent_seed, draw, trials
from experiment_runner.executors.job import Lost
from glue.engine.engine import role_seed
from glue.errors import GlueError
from glue.trajectory import Ending
from glue.types import Action, Observation, Step
from glue.wire.messages import ErrorCode, Kind, Role
from tests.clock import Clock
from tests.experiment_runner.competition.players import (
    SECRET,
    Dawdler,
    InThread,
    Thread,
    Walker,
    Watched,
    competition,
    reports_of,
)
from tests.scripted.peer import TIMEOUT, ScriptedPeer


def test_a_task_of_steps_is_played_to_its_last_step(tmp_path: Path) -> None:
    reports = reports_of(Walker(), tmp_path, steps=40)
    assert not reports.forfeit
    recorded = reports.episodes(tmp_path)
    assert sum(len(episode.steps) for episode in recorded) == 40
    returns = [result.episode_return for result in reports.results]
    assert [episode.episode_return for episode in recorded] == returns
    assert {episode.ending for episode in recorded[:-1]} <= {Ending.TERMINAL}


def test_what_a_late_agent_did_not_choose_is_recorded_as_it_was_carried_out(tmp_path: Path) -> None:
    watched = f"{Watched.__module__}:{Watched.__name__}"
    reports = reports_of(Dawdler(60), tmp_path, steps=60, env=watched, rate=200.0)
    assert not reports.forfeit
    recorded = reports.episodes(tmp_path)
    results = reports.results
    assert sum(result.late for result in results) >= 3
    (spec,) = trials(competition("alice", steps=60, env=watched, rate=200.0), SECRET)
    replayed, score = replay_trial(spec, tmp_path / "record.traj")
    assert [(steps, total, late) for _, steps, total, late in replayed] == [
        (len(episode.steps), episode.episode_return, len(episode.late)) for episode in recorded
    ]
    assert [len(episode.late) for episode in recorded][: len(results)] == [result.late for result in results]
    assert score == sum(result.episode_return for result in results)


def test_the_agents_seed_says_nothing_of_the_environments(tmp_path: Path) -> None:
    walker = Walker()
    reports_of(walker, tmp_path)
    (spec,) = trials(competition("alice"), SECRET)
    assert walker.seeds == [role_seed(agent_seed(spec), Role.AGENT)]
    assert agent_seed(spec) != spec.seed
    assert draw(SECRET, "trial", "walk", "0") == spec.seed


def test_every_entrant_meets_the_same_level_and_another_in_each_trial() -> None:
    specs = trials(competition("alice", "bob", trials=2, env="mario"), SECRET)
    levels: dict[str, object] = {
        spec.id: spec.environment.options["level_seed"] for spec in specs if spec.environment
    }
    assert levels["alice/walk/0"] == levels["bob/walk/0"]
    assert levels["alice/walk/0"] != levels["alice/walk/1"]
    assert trials(competition("alice", "bob", trials=2, env="mario"), SECRET + b"!") != specs


class Thinker(Walker):
    """Thinks for `seconds` about every answer, by the clock of the test."""

    def __init__(self, clock: Clock, seconds: float) -> None:
        super().__init__()
        self.clock = clock
        self.seconds = seconds

    def agent_step(self, reward: float, observation: Observation) -> Action:
        self.clock.now += self.seconds
        return self.act()


LIMITS = Limits(step_seconds=1.0, bank_seconds=5.0, start_seconds=30.0, total_seconds=1000.0)


def test_a_bank_that_is_drained_slowly_ends_the_task(tmp_path: Path) -> None:
    clock = Clock()
    thinker = Thinker(clock, 1.5)
    reports = reports_of(thinker, tmp_path, clock, limits=LIMITS)
    assert "bank of 5 s is empty" in reports.forfeit
    assert clock.now == 11 * 1.5  # the bank holds ten half seconds, and the eleventh is one too many
    assert reports.episodes(tmp_path)[-1].ending is Ending.VOID


class Asking(Thinker):
    """Asks what time is left."""

    def __init__(self, clock: Clock, seconds: float, answer: str) -> None:
        super().__init__(clock, seconds)
        self.answer = answer
        self.heard: list[str] = []

    def agent_message(self, message: str) -> str:
        self.heard.append(message)
        return self.answer


def test_an_agent_that_asks_is_told_what_time_is_left(tmp_path: Path) -> None:
    clock = Clock()
    asking = Asking(clock, 1.25, "yes")
    asking.path = (1,)
    reports = reports_of(asking, tmp_path, clock, limits=LIMITS, steps=16, max_steps=6, env="skeleton")
    assert not reports.forfeit
    first, *told = asking.heard
    assert first == ASK
    assert told[0] == f"time-left bank=5.000 total={LIMITS.total_seconds:.3f}"
    left = [float(message.split("=")[1].split()[0]) for message in told]
    assert left == [5.0, 3.75, 2.5, 1.25]
    (used,) = (report for report in reports if isinstance(report, Used))
    assert used == Used(None, None, 1.0)


def test_one_that_does_not_ask_hears_nothing_more(tmp_path: Path) -> None:
    clock = Clock()
    asking = Asking(clock, 0.0, "I do not understand your message")
    reports_of(asking, tmp_path, clock, limits=LIMITS)
    assert asking.heard == [ASK]


class LateThinker(Thinker):
    """Takes its time about the last call of an episode."""

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return self.act()

    def agent_end(self, reward: float) -> None:
        self.clock.now += self.seconds


class LateRaiser(Walker):
    def agent_end(self, reward: float) -> None:
        raise ValueError("at the end")


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
@pytest.mark.parametrize("late", [True, False])
def test_who_fails_after_the_last_step_of_an_episode_has_played_it(late: bool, tmp_path: Path) -> None:
    clock = Clock()
    agent = LateThinker(clock, 100.0) if late else LateRaiser()
    agent.path = (1,)
    reports = reports_of(agent, tmp_path, clock, limits=LIMITS, steps=400, env="skeleton")
    assert ("is empty" if late else "at the end") in reports.forfeit
    (episode,) = reports.episodes(tmp_path)
    assert episode.ending is Ending.TERMINAL
    assert len(reports.results) == 1


def test_an_episode_ends_at_its_step_limit(tmp_path: Path) -> None:
    reports = reports_of(Walker((1,)), tmp_path, steps=40, env="skeleton", max_steps=6)
    assert not reports.forfeit
    assert {len(episode.steps) for episode in reports.episodes(tmp_path)} == {5}


class Illegal(Walker):
    def agent_step(self, reward: float, observation: Observation) -> Action:
        return Action(ints=[99])


class Misshapen(Walker):
    def agent_start(self, observation: Observation) -> Action:
        return Action(ints=[1], doubles=[0.5])


class Wordless(Walker):
    def agent_step(self, reward: float, observation: Observation) -> Action:
        raise GlueError("\n")


class Raising(Walker):
    def agent_step(self, reward: float, observation: Observation) -> Action:
        raise ValueError("no\x1b[31m idea\n" + "x" * 400)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
@pytest.mark.parametrize(
    ("agent", "why"),
    [
        (Illegal(), "its action was refused"),
        (Misshapen(), "must return"),
        (Raising(), "raised in agent_step"),
        (Wordless(), "Wordless"),
    ],
)
def test_what_an_agent_does_wrong_is_the_reason_in_one_line(agent: Walker, why: str, tmp_path: Path) -> None:
    reason = reports_of(agent, tmp_path).forfeit
    assert why in reason
    assert reason.isprintable()
    assert len(reason) <= 300


def test_one_who_never_connects_forfeits(tmp_path: Path) -> None:
    ticks = itertools.count()
    reports = reports_of(None, tmp_path, lambda: float(next(ticks)), limits=Limits(start_seconds=5.0))
    assert reports.forfeit == "it did not connect within 5 s"
    assert reports.episodes(tmp_path) == []


class Initialised(MinesEnvironment):
    """Mines that says when it is initialised, which follows the news that an agent has joined."""

    done = threading.Event()

    def env_init(self) -> str:
        Initialised.done.set()
        return super().env_init()


class Returning(Thread):
    """A program that joins and leaves before its start is over; then it serves its agent, if it has one."""

    def __init__(self, agent: Any, launch: Launch) -> None:
        Initialised.done.clear()
        with ScriptedPeer(launch.hub, session=launch.session).greet() as peer:
            peer.join(Role.AGENT)
            peer.say(Kind.GOODBYE, 0, "done")
            peer.say(Kind.HEARTBEAT, 0)
            assert peer.receive().scalars[0] == ErrorCode.UNKNOWN_PEER  # the hub has read its goodbye
        super().__init__(agent, launch)

    def wait(self, seconds: float) -> bool:
        assert Initialised.done.wait(TIMEOUT)
        return super().wait(seconds)


def test_one_who_joins_leaves_and_stays_away_forfeits(tmp_path: Path) -> None:
    ticks = itertools.count()
    played = {"env": f"{__name__}:Initialised", "limits": Limits(start_seconds=5.0)}
    starter = InThread(None, Returning)
    reports = reports_of(starter, tmp_path, lambda: float(next(ticks)), **played)
    assert reports.forfeit == "it did not connect within 5 s"


def test_one_who_joins_leaves_and_returns_in_time_plays_on(tmp_path: Path) -> None:
    starter = InThread(Walker(), Returning)
    assert not reports_of(starter, tmp_path, Clock(), env=f"{__name__}:Initialised").forfeit


class Breaking(MinesEnvironment):
    def env_step(self, action: Action) -> Step:
        raise RuntimeError("broken")


def test_an_environment_that_fails_is_not_the_entrants_fault(tmp_path: Path) -> None:
    reports = reports_of(Walker(), tmp_path, env=f"{__name__}:Breaking")
    assert "RuntimeError: broken" in str(reports[-1].failure)
    assert not any(isinstance(report, Forfeited) for report in reports)


class AnyText(MinesEnvironment):
    """Mines whose actions may have text."""

    def env_init(self) -> str:
        return super().env_init().replace("ACTIONS INTS (0 3)", "ACTIONS INTS (0 3) CHARCOUNT 4000000")

    def env_step(self, action: Action) -> Step:
        return super().env_step(Action(ints=[0]))


def test_actions_that_no_record_can_hold_are_the_entrants_fault(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setattr("glue.trajectory.limits.MAX_EPISODE", 2**24)
    monkeypatch.setattr("experiment_runner.competition.environment.MAX_EPISODE", 2**24)

    class Verbose(Walker):
        def act(self) -> Action:
            self.steps += 1
            return Action(ints=[0], chars=self.steps.to_bytes(4, "big") * 1_000_000)

    reports = reports_of(Verbose(), tmp_path, env=f"{__name__}:AnyText", steps=40)
    assert "its actions take more than 16 MiB in an episode" in reports.forfeit
    assert reports.episodes(tmp_path)[-1].ending is Ending.VOID


class Overdrawn(Thread):
    """A program of which it is known, once it is stopped, that it took what it was not allowed to."""

    def stop(self) -> None:
        self.offence = "used more than 64 MiB of memory"


def test_an_offence_that_is_known_at_the_end_is_a_forfeit_too(tmp_path: Path) -> None:
    reports = reports_of(InThread(Walker(), Overdrawn), tmp_path)
    assert reports.forfeit == "its program used more than 64 MiB of memory"
    assert all(episode.ending is not Ending.VOID for episode in reports.episodes(tmp_path))


class Interrupted(Thread):
    """A program that is ended by whatever runs it."""

    def __init__(self, agent: Any, launch: Launch) -> None:
        super().__init__(agent, launch)
        self.reason = self.lost = "the container engine went away"

    def wait(self, seconds: float) -> bool:
        return True


def test_a_program_that_was_ended_from_outside_forfeits_nothing(tmp_path: Path) -> None:
    reports = reports_of(InThread(None, Interrupted), tmp_path)
    assert reports[-1] == Lost("the container engine went away")
    assert not any(isinstance(report, Forfeited) for report in reports)


def test_nobody_else_finds_the_socket(tmp_path: Path) -> None:
    """The socket's folder is inside one that other users cannot enter, and is removed afterwards."""
    modes = []

    class Curious(Walker):
        def agent_init(self, task_spec: str) -> None:
            modes.append(launcher.launches[0].folder.parent.stat().st_mode & 0o077)

    launcher = InThread(Curious())
    reports_of(launcher, tmp_path)
    assert modes == [0]
    assert not launcher.launches[0].folder.exists()
