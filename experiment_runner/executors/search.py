"""Search for the options of a plan's agents, then run the chosen ones with fresh seeds.

The folder of a tuned run has two runs: `search`, whose trials are added as configurations are proposed, and
`result`. Everything is determined by the plan and by the stored episodes: an interrupted search is repeated,
and finds the episodes that it has already run.

Samplers propose the configurations: a grid, random values, or Optuna's (extra `tune`). A sampler is asked for
configurations, and told their scores. The same seed and scores give the same configurations.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from experiment_runner.analysis.stats import interquartile_mean
from experiment_runner.executors.job import RunConfig
from experiment_runner.executors.opening import Definition, go_back, lengthen, open_run, remaining
from experiment_runner.executors.run import run_trials
from experiment_runner.plan.file import dump_plan
from experiment_runner.plan.plan import Plan, RoleSweep, TrialSpec, plain, trial_seed
from experiment_runner.plan.tuning import Range, Space, TunePlan
from experiment_runner.report.progress import Progress
from experiment_runner.report.tables import counted
from experiment_runner.store.layout import PLAN_FILE
from experiment_runner.store.records import TUNED
from experiment_runner.store.store import Store
from glue.errors import ExperimentError
from glue.files import read_text
from glue.installed import needing
from glue.options import Value

SEARCH: Final = "search"
RESULT: Final = "result"
_RUNG: Final = 4
"""Number of parts of a trial: a configuration may be pruned after the first, and its score is of the last."""


class _Chosen(NamedTuple):
    sweep: RoleSweep
    report: str


def tune(
    directory: Path, plan: Plan, config: RunConfig, reporter: Progress, again: str = ""
) -> tuple[Path, int]:
    """Search, and run the chosen configurations; return the result's directory and number of failed trials.

    Args:
        directory: contains both runs, or will contain them.
        plan: with a search.
        config: how trials are executed.
        reporter: shows progress.
        again: command that continues after an interruption; empty for none.

    Raises:
        ExperimentError: the folder is of another plan, or every configuration of an agent has failed.
        KeyboardInterrupt: on Ctrl-C or SIGTERM.
    """
    assert plan.tune is not None
    with _open(directory / SEARCH, plan, [], reporter.say) as store:

        def run(trial_ids: Container[str]) -> None:
            run_trials(store, config, reporter, again=again, only=trial_ids)

        chosen = [_search(store, plan, plan.tune, sweep, run, reporter.say) for sweep in plan.agents]
    specs = [
        spec
        for one in chosen
        for spec in _specs(plan, one.sweep, {}, range(plan.tune.trials, plan.tune.trials + plan.tune.final))
    ]
    with _open(directory / RESULT, plan, specs, reporter.say) as store:
        failed = run_trials(store, config, reporter, again=again)
        for one in chosen:
            if not one.report:
                continue
            score = _score(store, [spec for spec in specs if spec.id.startswith(f"{one.sweep.label}/")])
            here = f"in the {counted(plan.tune.final, 'trial')} here, with other seeds: {score:.2f}"
            store.record_once(TUNED, f"{one.report}; {here}")
        return directory / RESULT, failed


def _open(directory: Path, plan: Plan, specs: Sequence[TrialSpec], say: Callable[[str], None]) -> Store:
    text = dump_plan(plan)

    def check(store: Store) -> None:
        if read_text(directory / PLAN_FILE) != text:
            raise ExperimentError(f"{directory} is of another plan: choose another folder, or its own plan")

    players = [*plan.agents, *plan.environments]
    return open_run(directory, Definition(specs, {PLAN_FILE: text}, players, check), say=say)


def _search(
    store: Store,
    plan: Plan,
    tune: TunePlan,
    sweep: RoleSweep,
    run: Callable[[Container[str]], None],
    say: Callable[[str], None],
) -> _Chosen:
    """Return an agent with the options of its best configuration."""
    space = tune.agents.get(sweep.label)
    if space is None:
        return _Chosen(sweep, "")
    sampler = sampler_of(tune, space, trial_seed(plan.seed, sweep.label))
    scores: list[tuple[Configuration, Score]] = []
    known: list[float] = []  # the scores of all configurations after the first part
    while batch := sampler.ask(tune.configurations - len(scores)):
        trials = [_specs(plan, sweep, one, range(tune.trials)) for one in batch]
        kept = [True] * len(batch)
        if tune.prune:
            rungs = [[_shortened(spec) for spec in specs] for specs in trials]
            _run(store, [spec for specs in rungs for spec in specs], run, say)
            early = [_score(store, specs) for specs in rungs]
            first, known = len(known), known + early
            kept = [_among_the_better(known, first + i) for i in range(len(batch))]
        _run(store, [spec for specs, on in zip(trials, kept, strict=True) if on for spec in specs], run, say)
        found = [
            Score(_score(store, trials[i]), False) if on else Score(early[i], True)
            for i, on in enumerate(kept)
        ]
        sampler.tell(found)
        scores += zip(batch, found, strict=True)
    finished = [(one, score.value) for one, score in scores if not score.pruned and score.value > -math.inf]
    if not finished:
        raise ExperimentError(
            f"every configuration of {sweep.label} has failed, or ended no episode: see {store.directory}"
        )
    best, score = max(finished, key=lambda pair: pair[1])
    shown = " ".join(f"{name}={plain(value)}" for name, value in best.items())
    done = [trial for trial in store.trials() if trial.spec.id.startswith(f"{sweep.label}/")]
    episodes = sum(trial.done for trial in done)
    distinct = len({tuple(one.items()) for one, _ in scores})
    report = (
        f"{sweep.label} has {shown}, the best of {counted(distinct, 'configuration')} of a search (sampler "
        f"{tune.sampler}; {counted(len(done), 'trial')}, of {counted(episodes, 'episode')} in all). "
        f"Interquartile mean of the returns in the last quarter of each trial: in the search {score:.2f}"
    )
    return _Chosen(replace(sweep, options={**sweep.options, **best}), report)


def _among_the_better(scores: Sequence[float], number: int) -> bool:
    """Return whether a score is in the better half; of equal scores, earlier ones count as better."""
    mine = scores[number]
    better = sum(score > mine or (score == mine and i < number) for i, score in enumerate(scores))
    return better < (len(scores) + 1) // 2


def _specs(plan: Plan, sweep: RoleSweep, given: Mapping[str, Value], numbers: range) -> list[TrialSpec]:
    """Return the trials of an agent with these options, in each environment of the plan."""
    options = {name: value for name, value in sweep.options.items() if name not in given}
    options |= {name: (value,) for name, value in given.items()}  # each is a part of the ids
    agents = (RoleSweep(sweep.name, options, sweep.label),)
    return replace(plan, agents=agents, seeds="number", tune=None).expand(numbers)


def _shortened(spec: TrialSpec) -> TrialSpec:
    return replace(spec, episodes=-(-spec.episodes // _RUNG), steps=-(-spec.steps // _RUNG))


def _run(
    store: Store,
    specs: Sequence[TrialSpec],
    run: Callable[[Container[str]], None],
    say: Callable[[str], None],
) -> None:
    """Run the trials that the store does not have, or has only at a shorter length.

    A sampler may propose a configuration twice, even at once: it is run once. Trials of other configurations
    that have failed are not run again.
    """
    known = {trial.spec.id: trial.spec for trial in store.trials()}
    wanted = {spec.id: spec for spec in specs}
    new = [
        spec
        for spec in wanted.values()
        if (old := known.get(spec.id)) is None or (old.episodes, old.steps) < (spec.episodes, spec.steps)
    ]
    lengthen(store, new, say)
    left = [trial for trial in remaining(store) if trial.trial_id in wanted]
    for trial in left:
        if trial.trial_id in known:  # it has failed, or its players could not be saved at its shorter length
            go_back(store, trial)
    if left:
        run({trial.trial_id for trial in left})


def _score(store: Store, specs: Sequence[TrialSpec]) -> float:
    """Return the interquartile mean over trials of their mean return near the end; -inf if one failed.

    Only what is within the length of `specs` counts, so that a part's score stays the same after the rest.
    """
    reached = []
    failed = {trial.spec.id: trial for trial in store.trials() if trial.failure is not None}
    for spec in specs:
        returns = store.measure(spec.id, "return")
        if spec.steps:
            returns = returns[np.cumsum(store.measure(spec.id, "steps")) < spec.steps]
        else:
            returns = returns[: spec.episodes]
        trial = failed.get(spec.id)
        within = trial is not None and (trial.done < spec.episodes or trial.steps < spec.steps)
        if within or not returns.size:
            return -math.inf
        reached.append(float(returns[-max(1, returns.size // _RUNG) :].mean()))
    score = float(interquartile_mean(np.array(reached)))
    return score if math.isfinite(score) else -math.inf


Configuration = dict[str, Value]

_AT_ONCE: Final = 4
"""Number of configurations that Optuna proposes at a time, whatever the number of workers."""


class Score(NamedTuple):
    """The result of a configuration: its score, -inf if a trial has failed, and whether it was pruned."""

    value: float
    pruned: bool


class Sampler:
    """The choice of configurations: these, whatever their scores."""

    def __init__(self, configurations: Sequence[Configuration]) -> None:
        self._left = configurations

    def ask(self, most: int) -> Sequence[Configuration]:
        """Return the next configurations, at most `most`; none at the end."""
        asked, self._left = self._left[:most], self._left[most:]
        return asked

    def tell(self, scores: Sequence[Score]) -> None:
        """Take the scores of the configurations that `ask` returned last, in the same order."""


def sampler_of(tune: TunePlan, space: Space, seed: int) -> Sampler:
    """Return the sampler of a search.

    Args:
        tune: of the plan.
        space: the values of an agent's options.
        seed: of its random choices, 0 <= seed < 2**63.

    Raises:
        ConfigError: Optuna is not installed.
    """
    if tune.sampler == "grid":
        return Sampler(_grid(space, tune.configurations))
    if tune.sampler == "random":
        return Sampler(_random(space, tune.configurations, np.random.default_rng(seed)))
    return _Optuna(space, seed)


def _grid(space: Space, most: int) -> Sequence[Configuration]:
    values = [
        list(dict.fromkeys(one.at(i / (one.points - 1)) for i in range(one.points)))
        if isinstance(one, Range)
        else one
        for one in space.values()
    ]
    some = itertools.islice(itertools.product(*values), most)  # all of a grid may not fit into memory
    return [dict(zip(space, chosen, strict=True)) for chosen in some]


def _random(space: Space, count: int, generator: np.random.Generator) -> list[Configuration]:
    found = []
    for _ in range(count):
        drawn: Configuration = {}
        for name, one in space.items():
            share = float(generator.random())
            drawn[name] = one.at(share) if isinstance(one, Range) else one[int(share * len(one))]
        if drawn not in found:
            found.append(drawn)
    return found


class _Optuna(Sampler):
    """Optuna's tree-structured Parzen estimator."""

    def __init__(self, space: Space, seed: int) -> None:
        with needing("tune", "the sampler optuna needs Optuna"):
            import optuna
        optuna.logging.set_verbosity(optuna.logging.WARNING)
        self._space = space
        self._study = optuna.create_study(
            direction="maximize", sampler=optuna.samplers.TPESampler(seed=seed % 2**32)
        )
        self._states = optuna.trial.TrialState
        self._asked: list[Any] = []

    def ask(self, most: int) -> list[Configuration]:
        self._asked = [self._study.ask() for _ in range(min(most, _AT_ONCE))]
        return [
            {name: _suggested(trial, name, one) for name, one in self._space.items()} for trial in self._asked
        ]

    def tell(self, scores: Sequence[Score]) -> None:
        for trial, score in zip(self._asked, scores, strict=True):
            if not np.isfinite(score.value):
                self._study.tell(trial, state=self._states.FAIL)
            elif score.pruned:
                trial.report(score.value, 1)
                self._study.tell(trial, state=self._states.PRUNED)
            else:
                self._study.tell(trial, score.value)


def _suggested(trial: Any, name: str, one: Range | tuple[Value, ...]) -> Value:
    value: Value
    if isinstance(one, tuple):
        value = trial.suggest_categorical(name, one)
    elif one.integer:
        first, last = one.ends
        value = trial.suggest_int(name, int(first), int(last), log=one.log)
    else:
        value = trial.suggest_float(name, one.low, one.high, log=one.log)
    return value
