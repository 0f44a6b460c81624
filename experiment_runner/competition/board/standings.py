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
from experiment_runner.competition.course import Course
from experiment_runner.competition.records.journal import ENTER, Act
from experiment_runner.competition.records.record import digest, record_path
from experiment_runner.competition.records.seal import broken
from experiment_runner.plan.ids import TrialId
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
        player: what its settings name: an image, a command, the file of a key, a folder.
        id: what that name stood for: the image's id, or the public key; empty for others.
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
    player: str = ""
    id: str = ""


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
        acts: of its organiser, since the start.
    """

    competition: str
    tasks: tuple[str, ...]
    entrants: tuple[Standing, ...]
    program: str
    seeds: tuple[Seed, ...] = ()
    acts: tuple[Act, ...] = ()


def standings(results: Results, course: Course, reveal: bool = False) -> Standings:
    """Return the standings of a competition's run, which may be under way.

    Args:
        results: of the run.
        course: its tasks, entrants and acts.
        reveal: whether to include the seeds of the trials.

    Raises:
        ExperimentError: the run cannot be read, or was changed since it was sealed.
    """
    if changed := broken(results):
        raise ExperimentError(
            f"{changed} were changed since they were written: put them back in {results.directory}, or try "
            f"glue-compete verify {results.directory}"
        )
    competition = course.competition
    tasks = tuple(task.name for task in competition.tasks)
    excluded, counting = course.excluded, course.counting
    lowest = _lowest(
        results, {trial: counting[trial] for trial in counting if trial.parts[0] not in excluded}
    )
    found = {
        name: _Entrant(results, admitted, excluded.get(name), tasks, lowest)
        for name, admitted in course.entrants.items()
    }
    for planned, trial in counting.items():
        found[planned.parts[0]].add(planned, trial)
    return Standings(
        competition.name,
        tasks,
        _placed(list(found.values()), tasks),
        _program(results.directory),
        tuple(_seeds(results, course)) if reveal else (),
        tuple(one for one in course.acts if one.act != ENTER),
    )


def ranks(scores: Sequence[float]) -> list[float]:
    """Return the rank of each score, 1 for the highest; equal scores share the mean of their places."""
    above = [sum(other > score for other in scores) for score in scores]
    equal = [sum(other == score for other in scores) for score in scores]
    return [first + (count + 1) / 2 for first, count in zip(above, equal, strict=True)]


def _lowest(results: Results, counting: Mapping[TrialId, TrialId]) -> dict[tuple[str, int], float]:
    """Return the lowest verified score of trials played to the end, by task and number of the trial."""
    lowest: dict[tuple[str, int], float] = {}
    outcomes, verdicts = results.outcomes(), results.verdicts()
    for planned, trial in counting.items():
        outcome, verdict = outcomes.get(trial), verdicts.get(trial)
        if outcome and outcome.reason is None and verdict and verdict.problem is None:
            _, task, number = planned.parts
            lowest[task, number] = min(verdict.score, lowest.get((task, number), math.inf))
    return lowest


class _Entrant:
    """The verified score of each trial of an entrant, by task."""

    def __init__(
        self,
        results: Results,
        admitted: Act,
        excluded: str | None,
        tasks: Sequence[str],
        lowest: Mapping[tuple[str, int], float],
    ) -> None:
        self.admitted = admitted
        self.name = admitted.subject
        self.scores: dict[str, list[float]] = {task: [] for task in tasks}
        self.curves: dict[str, list[FloatArray]] = {task: [] for task in tasks}
        self.forfeits: list[Forfeit] = []
        self._results = results
        self._excluded = excluded
        self._lowest = lowest
        self._outcomes = results.outcomes()
        self._verdicts = results.verdicts()
        self._missing: list[str] = []

    def add(self, planned: TrialId, trial: TrialId) -> None:
        """Add a trial of the competition: what it scores is decided by the trial that counts for it."""
        _, task, number = planned.parts
        outcome, verdict = self._outcomes.get(trial), self._verdicts.get(trial)
        if outcome is None:
            self._missing.append("not played to the end yet")
            return
        if outcome.reason is not None:
            self.forfeits.append(Forfeit(task, number, outcome.reason))
        if verdict is None:
            self._missing.append("not verified yet: glue-compete verify does it")
        elif verdict.problem is not None:
            self._missing.append(f"not verified: {verdict.problem}")
        elif _digest(record_path(self._results.directory, trial)) != verdict.digest:
            self._missing.append("changed since it was verified")
        else:
            forfeited = outcome.reason is not None
            most = self._lowest.get((task, number), math.inf) if forfeited else math.inf
            self.scores[task].append(min(verdict.score, most))
            if not forfeited:
                self.curves[task].append(_curve(self._results.episodes(trial)))

    @property
    def missing(self) -> str:
        """Reason for having no place; empty if the entrant has one."""
        if self._excluded is not None:
            return f"excluded: {self._excluded}"
        if len(self._missing) > 1:
            return f"{len(self._missing)} trials: {self._missing[0]}"
        return self._missing[0] if self._missing else ""


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
                "",
                entrant.admitted.player,
                entrant.admitted.id,
            )
        )
    placed.sort(key=lambda standing: (standing.mean_rank, -standing.total, standing.name))
    others = [
        Standing(
            entrant.name,
            forfeits=tuple(entrant.forfeits),
            missing=entrant.missing,
            player=entrant.admitted.player,
            id=entrant.admitted.id,
        )
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


def _seeds(results: Results, course: Course) -> list[Seed]:
    planned = {trial.parts[1:]: trial for trial in course.counting if trial not in course.reruns}
    specs = {record.spec.id: record.spec for record in results.trials()}
    return [
        Seed(task, number, specs[trial].seed, environment.options)
        for (task, number), trial in planned.items()
        if trial in specs and (environment := specs[trial].environment) is not None
    ]


def _program(directory: Path) -> str:
    try:
        about = json.loads(read_text(directory / ABOUT_FILE))
        return one_line(str(about["program"]))
    except (OSError, ValueError, TypeError, KeyError, RecursionError) as error:
        raise ExperimentError(f"cannot read {directory / ABOUT_FILE}: {type(error).__name__}") from None
