"""The search for an agent's options: the same choice after interruptions, and results with other seeds."""

from __future__ import annotations

import re
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from agents.tabular import SarsaAgent
from experiment_runner.analysis.stats import interquartile_mean
from experiment_runner.executors.job import BOTH, Placement, RunConfig
from experiment_runner.executors.search import RESULT, SEARCH, Configuration, Score, _grid, sampler_of, tune
from experiment_runner.plan.file import dump_plan, parse_plan
from experiment_runner.plan.plan import Plan, RoleSweep
from experiment_runner.plan.tuning import Range, Space, TunePlan
from experiment_runner.store.records import TUNED
from experiment_runner.store.results import Results
from glue.errors import ExperimentError
from glue.types import Action, Observation
from tests.experiment_runner.executors.test_run import Silent
from tests.system.runs import contents

PLAN = parse_plan("""
episodes = 8
max_steps = 30

[tune]
configurations = 6
trials = 2
final = 3

[tune.agents.sarsa]
step_size = {low = 0.01, high = 1.0, log = true}
epsilon = [0.05, 0.5]

[environments.mines]
random_start = true

[agents.sarsa]
learning = true

[agents.random]
""")
CONFIG = RunConfig(Placement(inside=BOTH), checkpoint_every=3)


def searching(**changes: object) -> Plan:
    assert PLAN.tune is not None
    return replace(PLAN, tune=replace(PLAN.tune, **changes))  # type: ignore[arg-type]


def chosen(directory: Path) -> dict[str, list[dict[str, object]]]:
    """Return the options of each trial in the result, by agent."""
    found: dict[str, list[dict[str, object]]] = {}
    with Results.open(directory / RESULT) as results:
        for trial in results.trials():
            assert trial.finished
            assert trial.spec.agent is not None
            found.setdefault(trial.spec.agent.label, []).append(dict(trial.spec.agent.options))
    return found


def test_a_plan_with_a_search_is_read_as_it_is_written() -> None:
    for plan in PLAN, searching(sampler="grid", prune=True):
        assert parse_plan(dump_plan(plan)) == plan


@pytest.mark.parametrize(
    ("line", "near"),
    [
        ('sampler = "randon"', "random"),
        ("sampler = 3", "sampler cannot be 3; choose from random"),
        ("trials = 0x" + 5000 * "f", "trials .* not a number of thousands of digits"),
        ("trails = 3", "trials"),
        ("trials = 0", "trials"),
        ("[tune.agents.sarsas]\nstep_size = [0.1]", "sarsa"),
        ("[tune.agents.sarsa]\nstep_size = {low = 1.0, high = 0.1}", "greater"),
        ("[tune.agents.sarsa]\nstep_size = {low = 0.0, high = 0.1, log = true}", "above 0"),
        ('[tune.agents.sarsa]\nstep_size = {low = "a", high = 0.1}', "low must be a number, not 'a'"),
        (
            f"[tune.agents.sarsa]\nstep_size = {{low = 0x{5000 * 'f'}, high = 1}}",
            "from a number of thousands",
        ),
        ("[tune.agents.sarsa]\nstep_size = {low = 0, high = inf}", "from 0 to inf is too wide"),
        ("[tune.agents.sarsa]\nstep_size = {low = 1e-300, high = 1e300, log = true}", "too wide"),
        ("[tune.agents.sarsa]\nstep_size = {low = 0.2, high = 0.8, integer = true}", "no whole number"),
        ("[tune.agents.sarsa]\nstep_size = {lo = 0.1, high = 0.2}", "low"),
        ("[tune.agents.sarsa]\nstep_size = 3", "range"),
    ],
)
def test_a_wrong_search_is_refused_with_the_near_miss(line: str, near: str) -> None:
    with pytest.raises(ExperimentError, match=near):
        parse_plan(f"episodes = 3\n[agents.sarsa]\n[tune]\n{line}\n")


@pytest.mark.parametrize("prune", [False, True])
def test_the_best_configuration_runs_again_with_other_seeds(tmp_path: Path, prune: bool) -> None:
    result, failed = tune(tmp_path, searching(prune=prune), CONFIG, Silent())
    assert (result, failed) == (tmp_path / RESULT, 0)
    options = chosen(tmp_path)
    assert {label: len(trials) for label, trials in options.items()} == {"sarsa": 3, "random": 3}
    with Results.open(tmp_path / SEARCH) as search, Results.open(result) as results:
        scores: dict[str, list[float]] = {}
        for trial in search.trials():
            assert trial.spec.agent is not None
            if trial.done == 8:
                key = str(dict(trial.spec.agent.options))
                scores.setdefault(key, []).append(search.measure(trial.spec.id, "return")[-2:].mean())
        assert len(scores) < 6 if prune else len(scores) == 6
        best = max(scores, key=lambda key: float(interquartile_mean(np.array(scores[key]))))
        assert {str(one) for one in options["sarsa"]} == {best}
        seeds = [{trial.spec.seed for trial in run.trials()} for run in (search, results)]
        assert not seeds[0] & seeds[1]
        (event,) = [event for event in results.events() if event.kind == TUNED]
        assert "6 configurations" in event.text


@pytest.mark.parametrize(("sampler", "budget"), [("random", {"episodes": 0, "steps": 121}), ("optuna", {})])
def test_an_interrupted_search_comes_to_the_same_choice(
    tmp_path: Path, sampler: str, budget: dict[str, int]
) -> None:
    plan = replace(searching(sampler=sampler, prune=True, configurations=5), **budget)  # type: ignore[arg-type]
    tune(tmp_path / "whole", plan, CONFIG, Silent())
    interrupted = 0
    for after in (5, 29, 0):
        try:
            tune(tmp_path / "again", plan, CONFIG, Silent(after))
        except KeyboardInterrupt:
            interrupted += 1
    assert interrupted == 2
    assert chosen(tmp_path / "again") == chosen(tmp_path / "whole")
    for part in (SEARCH, RESULT):
        assert contents(tmp_path / "again" / part) == contents(tmp_path / "whole" / part)


def test_a_search_over_few_values_runs_each_once(tmp_path: Path) -> None:
    few = {"sarsa": {"epsilon": (0.05, 0.1)}}
    plan = searching(sampler="optuna", configurations=6, prune=True, trials=1, final=1, agents=few)
    result, failed = tune(tmp_path, plan, CONFIG, Silent())
    assert not failed
    with Results.open(tmp_path / SEARCH) as search, Results.open(result) as results:
        names = [trial.spec.id for trial in search.trials()]
        (event,) = (event for event in results.events() if event.kind == TUNED)
    assert sorted(names) == ["sarsa/epsilon=0.05/mines/0", "sarsa/epsilon=0.1/mines/0"]
    assert "the best of 2 configurations" in event.text
    assert re.search(r"in the search -?[\d.]+; in the 1 trial here, with other seeds: -?[\d.]+$", event.text)


class Forgetful(SarsaAgent):
    agent_save = agent_load = None  # type: ignore[assignment]


def test_configurations_of_players_that_cannot_save_are_pruned_and_start_over(tmp_path: Path) -> None:
    agent = replace(PLAN.agents[0], name=f"{__file__}:Forgetful")
    plan = replace(searching(prune=True, final=1), agents=(agent,))
    for name, kind in (("forgetful", plan), ("saved", replace(plan, agents=PLAN.agents[:1]))):
        assert tune(tmp_path / name, kind, CONFIG, Silent())[1] == 0
    for part in (SEARCH, RESULT):
        ours, theirs = contents(tmp_path / "forgetful" / part), contents(tmp_path / "saved" / part)
        assert {name: of[0] for name, of in ours.items()} == {name: of[0] for name, of in theirs.items()}


class Failing(Forgetful):
    """Fails in the second episode if epsilon is 0.2, and in the fifth if it is 0.3."""

    def __init__(self, *, epsilon: float = 0.1) -> None:
        super().__init__(epsilon=epsilon)
        self._left = {0.2: 2, 0.3: 5}.get(epsilon, 0)

    def agent_start(self, observation: Observation) -> Action:
        self._left -= 1
        if self._left == 0:
            raise ValueError
        return super().agent_start(observation)


@pytest.mark.parametrize("number", range(1, 20, 4))
def test_configurations_that_fail_do_not_end_a_search_or_change_one_that_is_interrupted(
    tmp_path: Path, number: int
) -> None:
    values = {"failing": {"epsilon": (0.2, 0.3, 0.05, 0.1, 0.4)}}
    search = TunePlan(values, sampler="grid", prune=True, trials=1)
    plan = replace(PLAN, agents=(RoleSweep(f"{__file__}:Failing", {}, "failing"),), tune=search)
    tune(tmp_path / "whole", plan, CONFIG, Silent())
    with suppress(KeyboardInterrupt):
        tune(tmp_path / "again", plan, CONFIG, Silent(number))
    tune(tmp_path / "again", plan, CONFIG, Silent())
    assert chosen(tmp_path / "again") == chosen(tmp_path / "whole")
    for part in (SEARCH, RESULT):
        assert contents(tmp_path / "again" / part) == contents(tmp_path / "whole" / part)


def test_another_plan_does_not_continue_a_search(tmp_path: Path) -> None:
    tune(tmp_path, searching(configurations=1), CONFIG, Silent())
    with pytest.raises(ExperimentError):
        tune(tmp_path, searching(configurations=2), CONFIG, Silent())


def test_of_a_grid_only_the_configurations_that_are_run_are_made() -> None:
    assert _grid({"a": Range(0, 1), "b": (1, 2, 3)}, 4) == [
        {"a": 0.0, "b": 1},
        {"a": 0.0, "b": 2},
        {"a": 0.0, "b": 3},
        {"a": 0.25, "b": 1},
    ]


@pytest.mark.parametrize("sampler", ["random", "grid", "optuna"])
def test_values_are_within_their_ranges(sampler: str) -> None:
    space: Space = {
        "rate": Range(1e-4, 1.0, log=True),
        "size": Range(1, 64, log=True, integer=True),
        "tiles": Range(0.5, 3.7, integer=True),
        "kind": ("a", "b"),
    }
    search = replace(TunePlan({"agent": space}, configurations=60), sampler=sampler)  # type: ignore[arg-type]
    asking = sampler_of(search, space, seed=3)
    found: list[Configuration] = []
    while len(found) < 40 and (batch := asking.ask(60 - len(found))):
        asking.tell([Score(float(one["rate"]), False) for one in batch])
        found += batch
    rates = np.array([one["rate"] for one in found], float)
    assert rates.min() >= 1e-4
    assert rates.max() <= 1.0
    assert np.median(rates) < 0.2 or sampler == "optuna"
    assert {type(one["size"]) for one in found} == {int}
    assert {one["tiles"] for one in found} == {1, 2, 3}
    assert {one["kind"] for one in found} == {"a", "b"}
