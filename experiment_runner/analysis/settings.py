"""The settings of one or more runs: groups of trials that differ only in their random seed."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Final, NamedTuple

import numpy as np

from experiment_runner.analysis.curves import StepTotals, per_step, step_returns
from experiment_runner.analysis.stats import FloatArray, mean_of_last
from experiment_runner.plan.limits import PACE, REMOTE
from experiment_runner.plan.plan import RoleSpec, TrialSpec
from experiment_runner.store.readings import NO_METRIC, Metric
from experiment_runner.store.records import MEASURES, TOTAL_REWARD, TrialRecord
from experiment_runner.store.results import Results
from experiment_runner.store.run_data import extras_of
from glue.console import one_line
from glue.errors import ExperimentError

REWARD: Final = "reward"
"""The measure that exists only as totals over steps: the reward of each step."""


@dataclass(frozen=True, slots=True)
class Setting:
    """Trials of one agent in one environment.

    agent        the agent's label, and the options that distinguish it from others of that label
    environment  the same for the environment; empty when all settings share it
    trials       the record of each trial
    values       the measure of each trial's episodes, (episodes so far,), without an episode that the trial's
                 budget of steps has cut off
    steps        the steps of all episodes; may be longer than the values
    per_step     whether the measure is `REWARD`: then the values are sums of rewards, each over an episode
                 or between two readings of the total reward
    metrics      a metric of the agent in each trial, if one was requested
    """

    agent: str
    environment: str
    trials: tuple[TrialRecord, ...]
    values: tuple[FloatArray, ...]
    steps: tuple[FloatArray, ...] = ()
    per_step: bool = False
    metrics: tuple[Metric, ...] = ()

    @property
    def label(self) -> str:
        """The setting's name, unique among these runs."""
        return f"{self.agent}, {self.environment}" if self.environment else self.agent

    def curves(self) -> FloatArray:
        """Return the values of the trials that count, shape (trials, episodes of the shortest)."""
        used = [self.values[i] for i in self.counted()]
        length = min((len(r) for r in used), default=0)
        return np.array([r[:length] for r in used]).reshape(len(used), length)

    def step_totals(self) -> list[StepTotals]:
        """Return the totals over steps of the trials in `curves`: of the return of the episode under way, of
        the reward, or of another measure of the episode under way.
        """
        return [self._totals(i) for i in self.counted()]

    def totals_by_trial(self) -> dict[str, StepTotals]:
        """Return the totals of every trial that has begun, by its id; see `step_totals`."""
        return {
            self.trials[i].spec.id: self._totals(i) for i, values in enumerate(self.values) if values.size
        }

    def _totals(self, trial: int) -> StepTotals:
        values, steps = self.values[trial], self.steps[trial]
        if self.per_step:
            return per_step(values, steps[: len(values)])
        return step_returns(values, steps)

    def final(self, window: int, over: str) -> FloatArray:
        """Return the performance of each trial of `curves` that has begun, shape (trials,).

        Args:
            window: number of last episodes or steps to average.
            over: `episodes` or `steps`.
        """
        if over == "episodes":
            return np.array([mean_of_last(values, window) for values in self.curves()])
        return np.array([trial.last(window) for trial in self.step_totals()])

    def counted(self) -> list[int]:
        """Return which of the trials count: the finished ones; if there are none, those that have begun.

        A trial that has failed does not count, as it is shorter than the others, and seldom by chance.
        """
        finished = [i for i, trial in enumerate(self.trials) if trial.finished]
        begun = [i for i, values in enumerate(self.values) if values.size and not self.trials[i].failure]
        return [i for i in finished if self.values[i].size] or begun


def collect(runs: Iterable[Results], measure: str = "return", metric: str = "") -> list[Setting]:
    """Return the settings of all runs together, in order of appearance.

    Args:
        runs: open for reading.
        measure: name of one of `experiment_runner.store.records.MEASURES`, of an extra's column, or `REWARD`.
        metric: name of a metric of the agent; empty for none.

    Raises:
        ExperimentError: two runs have a trial in common, or a run cannot be read.
    """
    groups: dict[str, list[_Trial]] = defaultdict(list)
    seen: dict[tuple[str, str, int], Results] = {}
    for run in runs:
        joined = {player: RoleSpec(name, label=name) for player, name in run.joined_players().items()}
        for trial in run.trials():
            spec = trial.spec
            agent = spec.agent or joined.get((spec.id, "agent"))
            environment = spec.environment or joined.get((spec.id, "environment"))
            trial = trial._replace(spec=replace(spec, agent=agent, environment=environment))
            key = json.dumps([_fields(agent), _fields(environment), _limits(spec)])
            same = seen.setdefault((key, trial.spec.id, trial.spec.seed), run)
            if same is not run:
                raise ExperimentError(f"trial {trial.spec.id} is in {same.directory} and in {run.directory}")
            groups[key].append(_read(run, trial, measure, metric))
    specs = [members[0].record.spec for members in groups.values()]
    agents = _names([(_label(spec.agent), _fields(spec.agent)) for spec in specs])
    environments = _names(
        [(_label(spec.environment), _fields(spec.environment) | _limits(spec)) for spec in specs]
    )
    if len(set(environments)) == 1:
        environments = [""] * len(specs)
    return [
        Setting(
            agent,
            environment,
            tuple(trial.record for trial in members),
            tuple(trial.values for trial in members),
            tuple(trial.steps for trial in members),
            measure == REWARD,
            tuple(trial.metric for trial in members if trial.metric is not None),
        )
        for agent, environment, members in zip(agents, environments, groups.values(), strict=True)
    ]


class _Trial(NamedTuple):
    record: TrialRecord
    values: FloatArray
    steps: FloatArray
    metric: Metric | None


def _read(run: Results, trial: TrialRecord, measure: str, metric: str) -> _Trial:
    name = trial.spec.id
    metrics = run.metrics(name) if metric or measure == REWARD else {}
    found = metrics.get(metric, NO_METRIC) if metric else None
    if measure == REWARD:
        total = metrics.get(TOTAL_REWARD, NO_METRIC)
        if total.steps.size:
            return _Trial(trial, np.diff(total.values, prepend=0.0), np.diff(total.steps, prepend=0.0), found)
        return _Trial(trial, run.measure(name, "return"), run.measure(name, "steps"), found)
    if measure in MEASURES:
        values = run.measure(name, measure)
    else:
        values = extras_of(run, trial.spec).get(measure, np.empty(0))
    if trial.spec.steps and run.cut_by_budget(name):
        values = values[: trial.done - 1]
    return _Trial(trial, values, run.measure(name, "steps"), found)


def _label(role: RoleSpec | None) -> str:
    return REMOTE if role is None else role.label


def _fields(role: RoleSpec | None) -> dict[str, object]:
    return {} if role is None else {"class": role.name, **role.options}


def _limits(spec: TrialSpec) -> dict[str, object]:
    limits: dict[str, object] = {"episodes": spec.episodes, "max_steps": spec.max_steps}
    limits |= {"steps": spec.steps} if spec.steps else {}
    return limits | ({name: getattr(spec.pace, name) for name in PACE} if spec.pace else {})


def _names(described: Sequence[tuple[str, Mapping[str, object]]]) -> list[str]:
    """Return each label, followed by the fields in which it differs from others of the same label."""
    names = []
    for label, fields in described:
        same_label = [other_fields for other, other_fields in described if other == label]
        differing = [name for name in fields if any(o.get(name) != fields[name] for o in same_label)]
        names.append(one_line(" ".join([label, *(f"{name}={fields[name]}" for name in differing)])))
    return names
