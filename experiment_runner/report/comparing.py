"""Comparisons of the agents of runs, in numbers: for people, and as JSON for scripts."""

from __future__ import annotations

import json
from collections import defaultdict
from typing import Final, NamedTuple

import numpy as np

from experiment_runner.analysis import stats
from experiment_runner.analysis.settings import Setting, collect
from experiment_runner.plan.plan import RoleSpec, plain
from experiment_runner.report.overview import FEW
from experiment_runner.report.tables import unfinished
from experiment_runner.store.results import Results
from experiment_runner.store.run_data import finite
from glue.errors import ExperimentError

COLUMNS: Final = ("A less B", "trials", "difference of IQM", "95 %", "P(A > B)", "95 %")
_WINDOW: Final = 100


class Row(NamedTuple):
    """The comparison of two settings: their names, and the numbers."""

    a: str
    b: str
    found: stats.Comparison

    def cells(self) -> tuple[str, ...]:
        """Return the cell of each of `COLUMNS`."""
        difference, improvement, trials = self.found
        return (
            f"{self.a} less {self.b}",
            f"{trials}{FEW if trials < stats.FEW_TRIALS else ''}",
            f"{difference.value:.2f}",
            f"{difference.low:.2f} to {difference.high:.2f}",
            f"{improvement.value:.2f}",
            f"{improvement.low:.2f} to {improvement.high:.2f}",
        )

    def as_json(self) -> dict[str, object]:
        """Return the comparison as a JSON object."""
        difference, improvement, trials = self.found
        return {
            "a": self.a,
            "b": self.b,
            "trials": trials,
            "difference": _numbers(difference),
            "probability_of_improvement": _numbers(improvement),
        }


def compared(a: Results, b: Results, over: str) -> list[Row]:
    """Return the comparison of each setting of a run with each in the same environment of another run.

    Args:
        a, b: open for reading.
        over: `episodes` or `steps`.

    Raises:
        ExperimentError: a run cannot be read, or the runs have no trials in common.
    """
    rng = stats.bootstrap_rng()
    rows = []
    others = [(theirs, _performance(theirs, over)) for theirs in collect([b])]
    for ours in collect([a]):
        one = _performance(ours, over)
        for theirs, other in others:
            if _environment(ours) != _environment(theirs):
                continue
            if seeds := [seed for seed in one if seed in other]:
                first, second = (np.array([found[seed] for seed in seeds]) for found in (one, other))
                rows.append(Row(ours.label, theirs.label, stats.compare(first, second, rng)))
    if not rows:
        raise ExperimentError(
            f"{a.directory} and {b.directory} have no trials with the same environment and seed that have "
            "ended an episode: run both with the same seed"
        )
    return rows


def needed(pilot: Results, difference: float, power: float, over: str) -> list[tuple[str, str, str]]:
    """Return for each setting its name, and its numbers of trials in the pilot and to detect the difference.

    Raises:
        ExperimentError: the run cannot be read, a setting has only one trial, or SciPy is not installed.
    """
    rows = []
    for setting in collect([pilot]):
        reached = np.array([*_performance(setting, over).values()])
        if len(reached) < 2:
            raise ExperimentError(f"{setting.label} has {len(reached)} trials: a pilot has at least two")
        found = stats.trials_needed(reached, difference, stats.bootstrap_rng(), power=power)
        rows.append((setting.label, str(len(reached)), "more than 1,000" if found is None else str(found)))
    return rows


def sensitivities(sweep: Results, over: str) -> list[tuple[str, ...]]:
    """Return for each agent of a sweep its configurations, environments, sensitivity and best configuration.

    Raises:
        ExperimentError: the run cannot be read, or no agent has two configurations in two environments.
    """
    scores: dict[str, dict[str, dict[str, float]]] = defaultdict(lambda: defaultdict(dict))
    for setting in collect([sweep]):
        agent = setting.trials[0].spec.agent
        if agent is not None and (reached := [*_performance(setting, over).values()]):
            options = " ".join(f"{name}={plain(value)}" for name, value in agent.options.items())
            scores[agent.label][options][_environment(setting)] = float(np.mean(reached))
    rows: list[tuple[str, ...]] = []
    for label, found in scores.items():
        environments = sorted(set.intersection(*(set(one) for one in found.values())))
        if len(found) < 2 or len(environments) < 2:
            continue
        table = np.array([[one[name] for name in environments] for one in found.values()])
        value, best = stats.sensitivity(table)
        rows.append((label, str(len(found)), str(len(environments)), f"{value:.3f}", [*found][best]))
    if not rows:
        raise ExperimentError(
            f"{sweep.directory} has no agent with two configurations, both in the same two environments"
        )
    return rows


def _performance(setting: Setting, over: str) -> dict[int, float]:
    """Return the performance of each trial that counts, by its seed."""
    seeds = [setting.trials[i].spec.seed for i in setting.counted()]
    if over == "steps":
        reached = [trial.last(max(1, int(trial.steps[-1]) // 10)) for trial in setting.step_totals()]
    else:
        reached = [stats.mean_of_last(setting.values[i], _WINDOW) for i in setting.counted()]
    return dict(zip(seeds, reached, strict=True))


def left_out(*runs: Results) -> list[str]:
    """Return a line for each run of which trials do not count, or not as a whole."""
    return [line for run in runs for line in unfinished(run.trials(), f" of {run.directory}")]


def _environment(setting: Setting) -> str:
    role: RoleSpec | None = setting.trials[0].spec.environment
    return "" if role is None else json.dumps([role.name, dict(role.options)], sort_keys=True)


def _numbers(estimate: stats.Estimate) -> dict[str, object]:
    return {name: finite(float(value)) for name, value in zip(estimate._fields, estimate, strict=True)}
