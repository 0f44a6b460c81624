from __future__ import annotations

import io
import threading
from dataclasses import replace
from pathlib import Path
from typing import Self

import numpy as np
import pytest

from experiment_runner.analysis.settings import collect
from experiment_runner.cli.run_plan import resume_command
from experiment_runner.executors.dispatcher import Dispatcher
from experiment_runner.executors.interrupts import Interrupts
from experiment_runner.executors.job import (
    BOTH,
    HubOptions,
    Job,
    Joined,
    Line,
    Lost,
    Placement,
    Recorded,
    Report,
    RunConfig,
)
from experiment_runner.executors.opening import open_run, remaining
from experiment_runner.executors.run import RunCollector, run_trials
from experiment_runner.executors.trial import run_job
from experiment_runner.plan.metrics import Keep, MetricsPlan
from experiment_runner.plan.plan import Plan, RoleSweep, TrialSpec
from experiment_runner.report.progress import Progress
from experiment_runner.store.records import TOTAL_REWARD, Checkpoint, EpisodeResult
from experiment_runner.store.results import Results
from experiment_runner.store.run_data import metric_table
from experiment_runner.store.store import Store
from glue.hub.config import LegacyPort
from tests.system.runs import contents

PLAN = Plan(
    episodes=12,
    max_steps=30,
    trials=3,
    environments=(RoleSweep("mines", {"random_start": True}),),
    agents=(RoleSweep("sarsa"),),
)
STEPS = replace(PLAN, episodes=0, steps=333)
FIRST, SECOND, THIRD = (spec.id for spec in PLAN.expand())
HERE = Placement(BOTH)
CONFIG = RunConfig(HERE, checkpoint_every=5)


class Silent(Progress):
    """Shows nothing; interrupts the run after a given number of episodes, if any."""

    def __init__(self, interrupt_after: int = 0) -> None:
        super().__init__(io.StringIO())
        self._left = interrupt_after
        self.names: dict[str, str] = {}
        self.said: list[str] = []

    def rename(self, spec: TrialSpec, name: str) -> None:
        self.names[spec.id] = name

    def episode(self, spec: TrialSpec, result: EpisodeResult) -> None:
        self._left -= 1
        if self._left == 0:
            raise KeyboardInterrupt

    def say(self, line: str) -> None:
        self.said.append(line)


class Unreliable:
    """An executor that delivers one report after another, and loses trials at given reports.

    Args:
        losses: per trial, the number of reports that each attempt makes; later attempts are not lost.
    """

    def __init__(self, size: int, losses: dict[str, list[int]]) -> None:
        self.size = size
        self.most_at_a_time = 0
        self._losses = losses
        self._running: dict[str, list[Report]] = {}

    def start(self, job: Job) -> None:
        reports: list[Report] = []
        run_job(job, reports.append)
        losses = self._losses.get(job.spec.id)
        if losses:
            reports[losses.pop(0) :] = [Lost("its worker was lost")]
        self._running[job.spec.id] = reports
        self.most_at_a_time = max(self.most_at_a_time, len(self._running))

    def receive(self, seconds: float) -> list[tuple[str, Report]]:
        received = [(trial_id, reports.pop(0)) for trial_id, reports in self._running.items()]
        self._running = {trial_id: reports for trial_id, reports in self._running.items() if reports}
        return received

    def cancel(self, trial_id: str) -> None: ...

    def stop(self) -> None: ...

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None: ...


def collector(store: Store, reporter: Silent | None = None, config: RunConfig = CONFIG) -> RunCollector:
    return RunCollector(store, config, reporter or Silent())


def play(directory: Path, plan: Plan) -> Path:
    with open_run(directory, plan) as store:
        assert run_trials(store, CONFIG, Silent()) == 0
    return directory


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return play(tmp_path_factory.mktemp("undisturbed") / "run", PLAN)


@pytest.fixture(scope="module")
def budgeted(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return play(tmp_path_factory.mktemp("budgeted") / "run", STEPS)


def hand_out(store: Store, pool: Unreliable, config: RunConfig = CONFIG) -> None:
    Dispatcher(pool, collector(store, config=config), Interrupts()).run(
        trial.trial_id for trial in remaining(store)
    )


def losses() -> dict[str, list[int]]:
    return {FIRST: [0, 3, 7, 0], SECOND: [11], THIRD: [12]}


@pytest.mark.parametrize(
    ("plan", "size", "whole"), [(PLAN, 1, "undisturbed"), (PLAN, 5, "undisturbed"), (STEPS, 2, "budgeted")]
)
def test_lost_trials_end_as_undisturbed_ones(
    plan: Plan, size: int, whole: str, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    pool = Unreliable(size, losses())
    with open_run(tmp_path / "run", plan) as store:
        hand_out(store, pool)
        lost = [event.trial_id for event in store.events() if event.kind == "lost"]
    assert contents(tmp_path / "run") == contents(request.getfixturevalue(whole))
    assert sorted(lost, key=str) == [FIRST] * 4 + [SECOND, THIRD]
    assert pool.most_at_a_time == min(size, 3)


def test_players_from_outside_are_shown_by_their_names(tmp_path: Path) -> None:
    plan = replace(PLAN, agents=())
    first, second, *_ = (spec.id for spec in plan.expand())
    shown = Silent()
    with open_run(tmp_path / "run", plan) as store:
        run = collector(store, shown)
        run.take(first, Joined("agent", "Jumper", "Python 3.11.7"))
        run.take(first, Line("hello"))
        run.take(second, Line("hello"))
    assert shown.names == {first: first.replace("remote", "Jumper")}
    assert shown.said[1:] == [f"{shown.names[first]}: hello", f"{second}: hello"]


def test_trial_that_gets_no_further_is_given_up(undisturbed: Path, tmp_path: Path) -> None:
    with open_run(tmp_path / "run", PLAN) as store:
        hand_out(store, Unreliable(2, {SECOND: [3, 2, 1, 12]}))
        assert [trial.failure for trial in store.trials()] == [
            None,
            "its worker was lost, 3 times without progress",
            None,
        ]
    with open_run(tmp_path / "run", PLAN) as store:  # the same command tries again
        hand_out(store, Unreliable(2, {}))
        assert [trial.failure for trial in store.trials()] == [None] * 3
    assert contents(tmp_path / "run") == contents(undisturbed)


def test_an_interrupted_run_says_how_to_continue_as_it_was_begun(tmp_path: Path) -> None:
    (tmp_path / "interrupted_one.py").write_text("from agents.tabular import SarsaAgent as One")
    plan = replace(PLAN, agents=(RoleSweep(f"{tmp_path}/interrupted_one.py:One"),))
    hub = HubOptions(
        bind=("tcp://*:5000",),
        session="a",
        insecure=True,
        legacy=(LegacyPort(4096, "a"),),
        keys=tmp_path / "keys",
    )
    placement = Placement(inside=BOTH, hub=hub, any_reward=True)
    config = RunConfig(placement, questions=("values",))
    reporter = Silent(interrupt_after=3)
    with open_run(tmp_path / "run", plan) as store:
        command = resume_command(store, config)
        with pytest.raises(KeyboardInterrupt):
            run_trials(store, config, reporter, again=command)

    expected = (
        f"glue-experiment --resume {tmp_path}/run '--bind=tcp://*:5000' --legacy-port=127.0.0.1:4096=a "
        f"--keys={tmp_path}/keys --session=a --insecure --any-reward --ask=values --trust"
    )
    assert command == expected
    assert command in reporter.said[-1]


def test_episodes_are_stored_together_before_they_are_reported(tmp_path: Path) -> None:
    heard: list[int] = []

    class Listening(Silent):
        def episode(self, spec: TrialSpec, result: EpisodeResult) -> None:
            heard.append(len(store.episodes(spec.id)))

    with open_run(tmp_path / "run", PLAN) as store:
        listened_to = collector(store, Listening())
        for episode in (1, 2):
            listened_to.take(FIRST, Recorded(EpisodeResult(episode, 1.0, 2, True, 0.5), None))
        assert heard == []
        watcher = threading.Thread(target=listened_to.take, args=(FIRST, Line("a player is restarted")))
        watcher.start()
        watcher.join()  # it must not touch the store, which belongs to this thread
        assert heard == []
        listened_to.take(FIRST, Joined("agent", "somebody", None))
        assert heard == [2, 2]
        saved = Checkpoint(b"agent", b"environment")
        listened_to.take(FIRST, Recorded(EpisodeResult(3, 1.0, 2, True, 0.5), saved))
        assert heard == [2, 2, 3]


def steps_of(directory: Path) -> list[int]:
    with Results.open(directory) as results:
        return [sum(e.steps for e in results.episodes(trial.spec.id)) for trial in results.trials()]


def test_a_budget_of_steps_cuts_off_the_last_episode(budgeted: Path, tmp_path: Path) -> None:
    with Results.open(play(tmp_path / "run", replace(PLAN, episodes=40))) as store:
        whole = {trial.spec.id: store.episodes(trial.spec.id) for trial in store.trials()}
    assert steps_of(budgeted) == [333] * 3
    with Results.open(budgeted) as results:
        for trial in results.trials():
            *complete, last = results.episodes(trial.spec.id)
            assert trial.finished
            assert all(map(EpisodeResult.repeats, complete, whole[trial.spec.id]))
            assert results.cut_by_budget(trial.spec.id) is not last.terminal
        (setting,) = collect([results])
    assert any(
        len(values) == trial.done - 1 for values, trial in zip(setting.values, setting.trials, strict=True)
    )


def test_a_larger_budget_extends_a_run_to_the_same_results(budgeted: Path, tmp_path: Path) -> None:
    play(tmp_path / "run", replace(STEPS, steps=150))
    with open_run(tmp_path / "run", STEPS) as store:
        assert run_trials(store, CONFIG, Silent()) == 0
    assert contents(tmp_path / "run") == contents(budgeted)


KEPT = {"mean TD error": Keep(3, averaged=True), "epsilon": Keep(2)}


@pytest.mark.parametrize(("every", "checkpoint_every"), [(0, 0), (7, 5)])
def test_metrics_of_lost_trials_are_those_of_undisturbed_ones(
    tmp_path: Path, every: int, checkpoint_every: int
) -> None:
    plan = replace(PLAN, metrics=MetricsPlan(every, KEPT))
    found = []
    for name, lost in (("undisturbed", {}), ("lost", losses())):
        with open_run(tmp_path / name, plan) as store:
            config = RunConfig(HERE, checkpoint_every, metrics=plan.metrics)
            hand_out(store, Unreliable(2, lost), config)
            found.append([[[*map(str, row)] for row in rows] for rows in metric_table(store).rows])
            readings = (
                sum(trial.done for trial in store.trials())
                if every == 0
                else sum(steps_of(store.directory)) // 7
            )
            size = len(store.metrics(FIRST)["step size"].values)
            assert len(store.metrics(FIRST)["mean TD error"].values) == size // 3
            assert len(store.metrics(FIRST)["epsilon"].values) == size // 2
            assert readings >= size > 0
    assert found[0] == found[1]


def test_the_total_reward_is_the_sum_of_the_returns(tmp_path: Path) -> None:
    plan = replace(STEPS, metrics=MetricsPlan(1))
    with open_run(tmp_path / "run", plan) as store:
        run_trials(store, RunConfig(HERE, metrics=plan.metrics), Silent())
        _, steps, totals = store.metrics(FIRST)[TOTAL_REWARD]
        returns = store.measure(FIRST, "return")
        ends = np.cumsum(store.measure(FIRST, "steps"))
        assert steps.tolist() == list(range(1, 334))
        np.testing.assert_allclose(totals[ends.astype(int) - 1], np.cumsum(returns))
