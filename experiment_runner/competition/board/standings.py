"""The ranks of a competition's entrants, from their verified trials.

The score of a trial is the sum of the rewards over all its steps, with learning included, as in the
RL Competition; that of a task is the mean over its trials. Entrants are placed by the mean of their ranks in
the tasks, and by the total of their scores. A forfeited trial scores what a passive agent earns, or the
lowest verified score of the entrants who played it to the end if that is lower, so that leaving never pays.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Final

import numpy as np

from experiment_runner.analysis.stats import FloatArray, bootstrap_rng
from experiment_runner.competition.records.record import digest, record_path
from experiment_runner.competition.records.seal import broken
from experiment_runner.competition.settings import Competition
from experiment_runner.plan.ids import TrialId
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.store.layout import ABOUT_FILE
from experiment_runner.store.records import EpisodeResult
from experiment_runner.store.results import Results
from glue.console import one_line
from glue.errors import ExperimentError
from glue.files import read_text

_RESAMPLES: Final = 10_000
"""Maximum size in bytes of the file that names the program that held the competition."""

_INTERVAL: Final = (2.5, 97.5)
_CURVE_POINTS: Final = 200
"""Number of intervals of a learning curve."""


@dataclass(frozen=True, slots=True)
class TaskScore:
    """Scores of an entrant in a task.

    Args:
        score: mean over the trials.
        trials: the score of each trial.
        rank: among the ranked entrants; ties get the mean of their places.
        curve: mean over the trials of the reward up to each of some fractions of the trial's steps, shape
            (points,); empty if the task was forfeited in every trial.
    """

    score: float
    trials: tuple[float, ...]
    rank: float
    curve: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class Forfeit:
    """A trial that an entrant did not play to its end."""

    task: str
    trial: int
    reason: str


@dataclass(frozen=True, slots=True)
class Standing:
    """An entrant's place.

    Args:
        name: of the entrant.
        place: by the mean of the ranks, from 1; ties share a place; None without a verified score in every
            trial.
        mean_rank: mean of the ranks in the tasks.
        place_by_total: by the total.
        total: sum of the tasks' scores, and its 95 % bootstrap interval over trials.
        low, high: the interval.
        tasks: by name.
        forfeits: trials that the entrant did not play to the end.
        missing: short reason for having no place.
    """

    name: str
    place: int | None = None
    mean_rank: float = math.nan
    place_by_total: int | None = None
    total: float = math.nan
    low: float = math.nan
    high: float = math.nan
    tasks: Mapping[str, TaskScore] = field(default_factory=dict)
    forfeits: tuple[Forfeit, ...] = ()
    missing: str = ""


@dataclass(frozen=True, slots=True)
class Seed:
    """The seed and options of a trial of a task, drawn from the secret seed."""

    task: str
    trial: int
    seed: int
    options: Mapping[str, object]


@dataclass(frozen=True, slots=True)
class Standings:
    """The board of a competition.

    Args:
        competition: its name.
        tasks: their names, in order.
        entrants: those with a place first, by place.
        program: name and version of the program that held it.
        seeds: the seeds of the trials, if they are revealed.
    """

    competition: str
    tasks: tuple[str, ...]
    entrants: tuple[Standing, ...]
    program: str
    seeds: tuple[Seed, ...] = ()


def standings(results: Results, competition: Competition, reveal: bool = False) -> Standings:
    """Return the standings of a competition's run, which may be under way.

    Args:
        results: of the run.
        competition: its tasks and entrants.
        reveal: whether to include the seeds of the trials.

    Raises:
        ExperimentError: the run cannot be read, or was changed since it was sealed.
    """
    if changed := broken(results):
        raise ExperimentError(
            f"{changed} were changed since they were written: put them back in {results.directory}, or try "
            f"glue-compete verify {results.directory}"
        )
    tasks = tuple(task.name for task in competition.tasks)
    specs = [record.spec for record in results.trials()]
    lowest = _lowest(results)
    found = {
        entrant.name: _Entrant(results, entrant.name, tasks, competition.trials, lowest)
        for entrant in competition.entrants
    }
    for spec in specs:
        name = spec.id.parts[0]
        if name in found:
            found[name].add(spec)
    return Standings(
        competition.name,
        tasks,
        _placed(list(found.values()), tasks),
        _program(results.directory),
        tuple(_seeds(specs, competition)) if reveal else (),
    )


def ranks(scores: Sequence[float]) -> list[float]:
    """Return the rank of each score, 1 for the highest; equal scores share the mean of their places."""
    above = [sum(other > score for other in scores) for score in scores]
    equal = [sum(other == score for other in scores) for score in scores]
    return [first + (count + 1) / 2 for first, count in zip(above, equal, strict=True)]


def _lowest(results: Results) -> dict[tuple[str, int], float]:
    """Return the lowest verified score of trials played to the end, by task and number of the trial."""
    lowest: dict[tuple[str, int], float] = {}
    outcomes = results.outcomes()
    for trial_id, verdict in results.verdicts().items():
        if trial_id in outcomes and outcomes[trial_id].reason is None and verdict.problem is None:
            _, task, number = TrialId(trial_id).parts
            lowest[task, number] = min(verdict.score, lowest.get((task, number), math.inf))
    return lowest


class _Entrant:
    """The verified score of each trial of an entrant, by task."""

    def __init__(
        self,
        results: Results,
        name: str,
        tasks: Sequence[str],
        trials: int,
        lowest: Mapping[tuple[str, int], float],
    ) -> None:
        self.name = name
        self.scores: dict[str, list[float]] = {task: [] for task in tasks}
        self.curves: dict[str, list[FloatArray]] = {task: [] for task in tasks}
        self.forfeits: list[Forfeit] = []
        self._results = results
        self._lowest = lowest
        self._expected = trials * len(tasks)
        self._outcomes = results.outcomes()
        self._verdicts = results.verdicts()
        self._missing: list[str] = []

    def add(self, spec: TrialSpec) -> None:
        _, task, number = spec.id.parts
        outcome, verdict = self._outcomes.get(spec.id), self._verdicts.get(spec.id)
        if outcome is None:
            self._missing.append("not played to the end yet")
            return
        if outcome.reason is not None:
            self.forfeits.append(Forfeit(task, number, outcome.reason))
        if verdict is None:
            self._missing.append("not verified yet: glue-compete verify does it")
        elif verdict.problem is not None:
            self._missing.append(f"not verified: {verdict.problem}")
        elif _digest(record_path(self._results.directory, spec.id)) != verdict.digest:
            self._missing.append("changed since it was verified")
        else:
            forfeited = outcome.reason is not None
            most = self._lowest.get((task, number), math.inf) if forfeited else math.inf
            self.scores[task].append(min(verdict.score, most))
            if not forfeited:
                self.curves[task].append(_curve(self._results.episodes(spec.id)))

    @property
    def missing(self) -> str:
        """Reason for having no place; empty if the entrant has one."""
        if self._missing:
            return (
                self._missing[0]
                if len(self._missing) == 1
                else f"{len(self._missing)} trials: {self._missing[0]}"
            )
        return "" if sum(map(len, self.scores.values())) == self._expected else "trials are missing"


def _placed(entrants: list[_Entrant], tasks: Sequence[str]) -> tuple[Standing, ...]:
    complete = [entrant for entrant in entrants if not entrant.missing]
    means = {task: [float(np.mean(entrant.scores[task])) for entrant in complete] for task in tasks}
    by_task = {task: ranks(means[task]) for task in tasks}
    totals = [sum(means[task][i] for task in tasks) for i in range(len(complete))]
    mean_ranks = [float(np.mean([by_task[task][i] for task in tasks])) for i in range(len(complete))]
    placed = []
    for i, entrant in enumerate(complete):
        low, high = _interval([entrant.scores[task] for task in tasks])
        scores = {
            task: TaskScore(
                means[task][i],
                tuple(entrant.scores[task]),
                by_task[task][i],
                _mean_curve(entrant.curves[task]),
            )
            for task in tasks
        }
        placed.append(
            Standing(
                entrant.name,
                1 + sum(other < mean_ranks[i] for other in mean_ranks),
                mean_ranks[i],
                1 + sum(other > totals[i] for other in totals),
                totals[i],
                low,
                high,
                scores,
                tuple(entrant.forfeits),
            )
        )
    placed.sort(key=lambda standing: (standing.mean_rank, -standing.total, standing.name))
    others = [
        Standing(entrant.name, forfeits=tuple(entrant.forfeits), missing=entrant.missing)
        for entrant in entrants
        if entrant.missing
    ]
    return (*placed, *others)


def _interval(scores: Sequence[Sequence[float]]) -> tuple[float, float]:
    """Return the 95 % percentile bootstrap interval of the total: trials are resampled within each task."""
    rng = bootstrap_rng()
    totals = np.zeros(_RESAMPLES)
    for trials in scores:
        chosen = rng.integers(0, len(trials), (_RESAMPLES, len(trials)))
        totals += np.array(trials)[chosen].mean(axis=1)
    low, high = np.percentile(totals, _INTERVAL)
    return float(low), float(high)


def _curve(episodes: Sequence[EpisodeResult]) -> FloatArray:
    """Return the reward earned up to each of `_CURVE_POINTS` + 1 fractions of a trial's steps, 0 to 1."""
    if not episodes:
        return np.zeros(0)
    steps = np.cumsum([episode.steps for episode in episodes])
    earned = np.cumsum([episode.episode_return for episode in episodes])
    at = np.linspace(0, steps[-1], _CURVE_POINTS + 1)
    return np.interp(at, np.concatenate(([0], steps)), np.concatenate(([0.0], earned)))


def _mean_curve(curves: Sequence[FloatArray]) -> tuple[float, ...]:
    whole = [curve for curve in curves if len(curve)]
    return tuple(np.mean(whole, axis=0).tolist()) if whole else ()


def _digest(path: Path) -> bytes:
    return digest(path) if path.is_file() else b""


def _seeds(specs: Sequence[TrialSpec], competition: Competition) -> list[Seed]:
    first = competition.entrants[0].name
    seeds = []
    for spec in specs:
        name, task, number = spec.id.parts
        if name == first and spec.environment is not None:
            seeds.append(Seed(task, number, spec.seed, spec.environment.options))
    return seeds


def _program(directory: Path) -> str:
    try:
        about = json.loads(read_text(directory / ABOUT_FILE))
        return one_line(str(about["program"]))
    except (OSError, ValueError, TypeError, KeyError, RecursionError) as error:
        raise ExperimentError(f"cannot read {directory / ABOUT_FILE}: {type(error).__name__}") from None
