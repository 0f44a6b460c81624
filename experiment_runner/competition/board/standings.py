"""The ranks of a competition's entrants, from their verified trials.

The score of a trial is the sum of the rewards over all its steps, with learning included, as in the
RL Competition; that of a task is the mean over its trials. Entrants are placed by the mean of their ranks in
the tasks, and by the total of their scores. A forfeited trial scores what a passive agent earns, or the
lowest verified score of the entrants who played it to the end if that is lower, so that leaving never pays.
"""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from experiment_runner.analysis.stats import FloatArray, bootstrap_rng
from experiment_runner.competition.course import Course
from experiment_runner.competition.records.journal import ADD, ANNOUNCE, EXCLUDE, READMIT, RERUN, Act
from experiment_runner.competition.records.record import digest, record_path
from experiment_runner.competition.records.seal import check_seal
from experiment_runner.plan.limits import TrialId
from experiment_runner.store.layout import ABOUT_FILE
from experiment_runner.store.records import EpisodeResult
from experiment_runner.store.results import Results
from glue.console import one_line
from glue.errors import ExperimentError
from glue.files import read_text

_SHOWN: Final = (ADD, ANNOUNCE, EXCLUDE, READMIT, RERUN)
"""Acts that the standings show: those about trials, not those of a season."""

_RESAMPLES: Final = 10_000
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
        late: share of its actions that were late, in the tasks with a rate; NaN without one.
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
    late: float = math.nan


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
        ExperimentError: the run cannot be read, was changed since it was sealed, or its season is not closed.
    """
    if course.in_season:
        raise ExperimentError("the season is not closed: there are no standings yet, only its board")
    check_seal(results)
    tasks = tuple(task.name for task in course.competition.testing)
    excluded = course.excluded
    judged: dict[str, list[_Judged]] = {name: [] for name in course.entrants}
    lowest: dict[tuple[str, int], float] = {}
    for one in _judged(results, course):
        name, level = one.trial.parts[0], one.trial.parts[1:]
        judged[name].append(one)
        if name not in excluded and one.forfeit is None and not one.missing:
            lowest[level] = min(one.score, lowest.get(level, math.inf))
    found = [
        _standing(admitted, judged[name], excluded.get(name), tasks, lowest)
        for name, admitted in course.entrants.items()
    ]
    return Standings(
        course.competition.name,
        tasks,
        (*_placed([one for one in found if not one.missing], tasks), *(one for one in found if one.missing)),
        _program(results.directory),
        tuple(_seeds(results, course)) if reveal else (),
        tuple(one for one in course.acts if one.act in _SHOWN and (one.act != RERUN or one.trial)),
    )


def ranks(scores: Sequence[float]) -> list[float]:
    """Return the rank of each score, 1 for the highest; equal scores share the mean of their places."""
    above = [sum(other > score for other in scores) for score in scores]
    equal = [sum(other == score for other in scores) for score in scores]
    return [first + (count + 1) / 2 for first, count in zip(above, equal, strict=True)]


class _Judged(NamedTuple):
    """A trial of the competition, by the trial that counts for it.

    trial       of the competition
    missing     why it has no score; empty if it has one
    forfeit     why it was forfeited; None if it was not
    score       verified
    curve       see `_curve`
    late        number of late actions, and of all; none without a rate
    """

    trial: TrialId
    missing: str
    forfeit: str | None = None
    score: float = math.nan
    curve: FloatArray = np.zeros(0)
    late: tuple[int, int] = (0, 0)


def _judged(results: Results, course: Course) -> Iterator[_Judged]:
    outcomes, verdicts, late = results.outcomes(), results.verdicts(), results.late_actions()
    for planned, trial in course.counting.items():
        outcome, verdict = outcomes.get(trial), verdicts.get(trial)
        if outcome is None:
            yield _Judged(planned, "not played to the end yet")
        elif verdict is None:
            yield _Judged(planned, "not verified yet: glue-compete verify does it", outcome.reason)
        elif verdict.problem is not None:
            yield _Judged(planned, f"not verified: {verdict.problem}", outcome.reason)
        elif not (path := record_path(results.directory, trial)).is_file() or digest(path) != verdict.digest:
            yield _Judged(planned, "changed since it was verified", outcome.reason)
        else:
            curve = _curve(results.episodes(trial) if outcome.reason is None else ())
            timed = late.get(trial, (0, 0))
            yield _Judged(planned, "", outcome.reason, verdict.score, curve, timed)


def _standing(
    admitted: Act,
    judged: Sequence[_Judged],
    excluded: str | None,
    tasks: Sequence[str],
    lowest: Mapping[tuple[str, int], float],
) -> Standing:
    """Return an entrant's standing without its places, which depend on the others."""
    missing = [one.missing for one in judged if one.missing]
    why = missing[0] if missing else ""
    if len(missing) > 1:
        why = f"{len(missing)} trials: {why}"
    if excluded is not None:
        why = f"excluded: {excluded}"
    scores: dict[str, TaskScore] = {}
    for task in () if why else tasks:
        theirs = [one for one in judged if one.trial.parts[1] == task]
        trials = tuple(
            one.score if one.forfeit is None else min(one.score, lowest.get(one.trial.parts[1:], math.inf))
            for one in theirs
        )
        curves = [one.curve for one in theirs if len(one.curve)]
        curve = tuple(np.mean(curves, axis=0).tolist()) if curves else ()
        scores[task] = TaskScore(float(np.mean(trials)), trials, math.nan, curve)
    late, actions = (sum(one.late[i] for one in judged) for i in (0, 1))
    return Standing(
        admitted.subject,
        tasks=scores,
        forfeits=tuple(
            Forfeit(*one.trial.parts[1:], one.forfeit) for one in judged if one.forfeit is not None
        ),
        missing=why,
        player=admitted.player,
        id=admitted.id,
        late=late / actions if actions and not why else math.nan,
    )


def _placed(entrants: Sequence[Standing], tasks: Sequence[str]) -> list[Standing]:
    by_task = {task: ranks([one.tasks[task].score for one in entrants]) for task in tasks}
    totals = [sum(one.tasks[task].score for task in tasks) for one in entrants]
    mean_ranks = [float(np.mean([by_task[task][i] for task in tasks])) for i in range(len(entrants))]
    placed = []
    for i, one in enumerate(entrants):
        low, high = interval(tuple(one.tasks[task].trials for task in tasks))
        placed.append(
            replace(
                one,
                place=1 + sum(other < mean_ranks[i] for other in mean_ranks),
                mean_rank=mean_ranks[i],
                place_by_total=1 + sum(other > totals[i] for other in totals),
                total=totals[i],
                low=low,
                high=high,
                tasks={task: replace(one.tasks[task], rank=by_task[task][i]) for task in tasks},
            )
        )
    return sorted(placed, key=lambda one: (one.mean_rank, -one.total, one.name))


@lru_cache(maxsize=4096)
def interval(scores: tuple[tuple[float, ...], ...]) -> tuple[float, float]:
    """Return the 95 % percentile bootstrap interval of a total: trials are resampled within each task.

    Args:
        scores: of the trials of each task.
    """
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
