from __future__ import annotations

import math
import signal
import threading
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import pytest

from agents.baselines import RandomAgent
from agents.tabular import SarsaAgent
from env_server.toys import MinesEnvironment
from experiment_runner.executors.interrupts import Interrupts
from experiment_runner.executors.job import (
    BEGINNING,
    Happened,
    Job,
    Line,
    Placement,
    Recorded,
    Report,
    RunConfig,
    Start,
    Voided,
)
from experiment_runner.executors.trial import Trial
from experiment_runner.plan.limits import TrialId
from experiment_runner.plan.metrics import MetricsPlan
from experiment_runner.plan.plan import RoleSpec, TrialSpec
from experiment_runner.store.records import Answer, Checkpoint, EpisodeResult, Reading
from glue import Action, Agent, Environment, Experiment, GlueError, PeerLost, Step, local
from glue.engine.local import LocalExperiment
from glue.pace import Pace
from glue.trajectory import TrajectoryWriter
from glue.wire.messages import Kind
from tests.hubs import over_the_hub

MINES = RoleSpec("mines", {"random_start": True})
SPEC = TrialSpec(TrialId("sarsa/mines/0"), RoleSpec("sarsa"), MINES, episodes=25, max_steps=40, seed=5)


class Kept:
    """Keeps every report."""

    def __init__(self) -> None:
        self.results: list[EpisodeResult] = []
        self.checkpoints: dict[int, Checkpoint] = {}
        self.answers: list[tuple[Answer, ...]] = []
        self.voids: list[int] = []
        self.events: list[str] = []
        self.said: list[str] = []
        self.readings: list[Reading] = []

    def __call__(self, report: Report) -> None:
        match report:
            case Recorded(result, checkpoint, answers, readings):
                assert not self.results or result.episode == self.results[-1].episode + 1
                self.results.append(result)
                self.answers.append(answers)
                self.readings += readings
                if checkpoint is not None:
                    self.checkpoints[result.episode] = checkpoint
            case Voided(episode):
                self.voids.append(episode)
            case Happened(kind):
                self.events.append(kind)
            case Line(line):
                self.said.append(line)

    @property
    def numbers(self) -> list[tuple[float, ...]]:
        return [result[:4] for result in self.results]


def play(
    glue: Experiment,
    every: int = 0,
    *,
    spec: TrialSpec = SPEC,
    start: Start = BEGINNING,
    kept: Kept | None = None,
    interrupts: Interrupts | None = None,
    recording: TrajectoryWriter | None = None,
    **settings: Any,
) -> Kept:
    """Play a trial with a checkpoint every so many episodes; return its reports, with those of `kept`."""
    kept = Kept() if kept is None else kept
    job = Job(spec, RunConfig(checkpoint_every=every, **settings), start)
    Trial(glue, job, kept, interrupts or Interrupts(), recording).run()
    return kept


class Lossy(Experiment):
    """Loses players at chosen calls, counted from 1; fresh ones are there for the next.

    Both are lost before the call; or, with an environment, the agent after the environment's part in it.
    """

    def __init__(
        self,
        losses: Mapping[Kind, set[int]],
        agent: Callable[[], Agent],
        environment: Environment | None = None,
    ) -> None:
        self._losses = losses
        self._agent = agent
        self._environment = environment
        self._counts: Counter[Kind] = Counter()
        self._players = self._fresh()
        self._seed: int | None = None
        self._task_spec = ""

    def _fresh(self) -> LocalExperiment:
        self._newcomer = self._agent()
        return local(self._newcomer, mines() if self._environment is None else self._environment)

    def _call(self, kind: Kind, scalars: tuple[Any, ...] = (), body: Any = None) -> tuple[Any, Any]:
        self._counts[kind] += 1
        lost = self._counts[kind] in self._losses.get(kind, ())
        if self._environment is not None or not lost:
            reply = self._players._call(kind, scalars, body)
        if kind is Kind.RL_INIT:
            self._seed = scalars[0]
            self._task_spec = "" if lost else reply[1]
        if lost:
            self._players = self._fresh()
            if self._environment is not None:
                self._newcomer.agent_init(self._task_spec)
            elif kind is not Kind.RL_INIT:
                self._players.rl_init(self._seed)
            raise PeerLost("the agent was lost")
        return reply


def mines() -> Environment:
    return MinesEnvironment(random_start=True)


@cache
def undisturbed(every: int = 0) -> Kept:
    return play(local(SarsaAgent(), mines()), every)


def test_every_episode_is_recorded_with_the_checkpoints_that_are_due() -> None:
    kept = undisturbed(every=10)
    assert [result.episode for result in kept.results] == list(range(1, 26))
    assert list(kept.checkpoints) == [10, 20, 25]
    assert not kept.voids
    assert not kept.events
    assert any(result.terminal for result in kept.results)
    assert all(result.steps <= 40 for result in kept.results)


@pytest.mark.parametrize(
    ("planned", "kept_at"),
    [(Pace(), [1, 2, 3, 4]), (Pace(rate=10.0), [1, 2, 3, 4]), (Pace(delay=1), [3, 4])],
)
@pytest.mark.parametrize("glue", [local, over_the_hub])
def test_what_may_depend_on_a_clock_has_a_checkpoint_after_each_episode(
    glue: Callable[..., Any], planned: Pace, kept_at: list[int]
) -> None:
    """Also where no plan has a pace, but the running hub has."""
    spec = replace(SPEC, episodes=4, pace=planned)
    with glue(SarsaAgent(), mines(), pace=Pace(delay=1)) as paced:
        assert list(play(paced, 3, spec=spec).checkpoints) == kept_at


@pytest.mark.parametrize("after", [10, 20])
def test_trial_continues_from_a_checkpoint_as_if_never_interrupted(after: int) -> None:
    whole = undisturbed(every=10)
    kept = play(local(SarsaAgent(), mines()), 10, start=Start(after, whole.checkpoints[after]))
    assert kept.numbers == whole.numbers[after:]
    assert kept.checkpoints[25] == whole.checkpoints[25]


@pytest.mark.parametrize(
    ("losses", "voids"),
    [
        ({Kind.RL_EPISODE: {1}}, [1]),
        ({Kind.RL_EPISODE: {14}}, [14]),
        ({Kind.RL_EPISODE: {10, 14, 16}}, [10, 10, 10]),  # later losses while repeating the first nine
        ({Kind.RL_EPISODE: {11, 12, 13}}, [11, 11, 11]),
        ({Kind.RL_INIT: {1, 2}}, [1, 1]),
        ({Kind.RL_AGENT_LOAD: {1}, Kind.RL_EPISODE: {13}}, [13, 13]),
        ({Kind.RL_AGENT_SAVE: {2}}, []),
        ({Kind.RL_RETURN: {3}}, [3]),
    ],
)
def test_loss_of_players_that_can_save_leaves_no_trace_in_the_results(
    losses: dict[Kind, set[int]], voids: list[int]
) -> None:
    whole, kept = undisturbed(every=10), play(Lossy(losses, SarsaAgent), 10)
    assert kept.numbers == whole.numbers
    assert kept.checkpoints[25] == whole.checkpoints[25]
    assert kept.voids == voids
    assert "differs" not in kept.events


class Forgetful(RandomAgent):
    """Cannot be saved."""

    agent_save = agent_load = None  # type: ignore[assignment]


def test_player_that_cannot_save_is_replaced_and_the_trial_continues() -> None:
    kept = play(Lossy({Kind.RL_EPISODE: {4}}, Forgetful), 10)
    assert len(kept.results) == SPEC.episodes
    assert kept.voids == [4]
    assert kept.events == ["replaced", "unsaved"]
    assert not kept.checkpoints


def test_an_agent_without_metrics_is_named_once() -> None:
    kept = play(local(RandomAgent(), mines()), 10, metrics=MetricsPlan(7))
    assert len(kept.results) == SPEC.episodes
    assert kept.events == ["unmetered"]


def test_episode_that_cannot_be_repeated_is_noted() -> None:
    seeds = iter(range(100))
    kept = play(Lossy({Kind.RL_EPISODE: {6}}, lambda: RandomAgent(seed=next(seeds))))
    assert len(kept.results) == SPEC.episodes
    assert "differs" in kept.events


class Untidy(SarsaAgent):
    def __init__(self, how: BaseException) -> None:
        super().__init__()
        self._how = how

    def agent_cleanup(self) -> None:
        raise self._how


@pytest.mark.parametrize(
    "glue",
    [
        lambda: local(Untidy(ValueError("untidy")), mines()),
        lambda: local(Untidy(SystemExit(3)), mines()),
        lambda: Lossy({Kind.RL_CLEANUP: {1}}, SarsaAgent),
    ],
    ids=["error", "exit", "loss"],
)
def test_cleanup_that_fails_takes_nothing_from_a_finished_trial(glue: Callable[[], Experiment]) -> None:
    kept = play(glue())
    assert kept.numbers == undisturbed().numbers
    assert kept.events == ["cleanup"]


def test_what_is_repeated_after_a_loss_is_said() -> None:
    kept = play(Lossy({Kind.RL_EPISODE: {14}}, SarsaAgent), 10)
    assert len(kept.said) == 1
    assert "3 episodes" in kept.said[0]
    assert "episode 10" in kept.said[0]


def test_interrupted_episode_ends_and_is_stored_with_a_checkpoint() -> None:
    class Interrupting(SarsaAgent):
        episodes = 0

        def agent_start(self, observation: Any) -> Any:
            self.episodes += 1
            if self.episodes == 7:
                signal.raise_signal(signal.SIGINT)
            return super().agent_start(observation)

    kept, whole = Kept(), undisturbed()
    with pytest.raises(KeyboardInterrupt), Interrupts(grace=60) as interrupts:
        play(local(Interrupting(), mines()), 100, kept=kept, interrupts=interrupts)
    assert kept.numbers == whole.numbers[:7]
    assert list(kept.checkpoints) == [7]
    play(local(SarsaAgent(), mines()), kept=kept, start=Start(7, kept.checkpoints[7]))
    assert kept.numbers == whole.numbers


@pytest.mark.parametrize("again", [False, True])
def test_episode_that_does_not_end_is_interrupted(again: bool) -> None:
    class Endless(SarsaAgent):
        def agent_step(self, reward: float, observation: Any) -> Any:
            signal.raise_signal(signal.SIGINT)
            if again:
                signal.raise_signal(signal.SIGINT)
            return threading.Event().wait()

    kept = Kept()
    grace = 60 if again else 0.01
    with pytest.raises(KeyboardInterrupt), Interrupts(grace) as interrupts:
        play(local(Endless(), mines()), kept=kept, interrupts=interrupts)
    assert not kept.results
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_two_episodes_of_players_that_cannot_save_end_in_silence() -> None:
    """Before the first checkpoint is due, no checkpoint is missing."""
    kept = play(local(Forgetful(), mines()), 100, spec=replace(SPEC, episodes=2))
    assert (len(kept.numbers), kept.events, kept.said) == (2, [], [])


@pytest.mark.parametrize("reward", [math.nan, math.inf, -math.inf])
def test_return_that_is_not_finite_ends_the_trial(reward: float) -> None:
    """Even if the single rewards were not checked."""

    class Odd(MinesEnvironment):
        def env_step(self, action: Action) -> Step:
            _, observation, terminal, *_ = super().env_step(action)
            return Step(reward, observation, terminal)

    with pytest.raises(GlueError, match=f"episode 1 is {reward}"):
        play(local(RandomAgent(), Odd()))
    one = replace(SPEC, episodes=1)
    assert len(play(local(RandomAgent(), Odd()), spec=one, placement=Placement(any_reward=True)).numbers) == 1
