"""What the scores of several trials say: mean, interquartile mean, intervals, and the generalisation gap.

As in rliable: the interquartile mean is the mean of the middle half of the scores of all trials and levels,
and intervals are 95 % percentile bootstrap intervals that resample trials within each level. With one trial
there is nothing to resample within a level; then the levels themselves are resampled.

Source: Agarwal et al. (2021), Deep reinforcement learning at the edge of the statistical precipice.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

import numpy as np

from experiment_runner.analysis.stats import FloatArray, Statistic, bootstrap_rng, interquartile_mean, mean

__all__ = ["Interval", "Summary", "summarise", "table"]

_RESAMPLES: Final = 1000
_TAILS: Final = (2.5, 97.5)
_SCORES: Final = ("goal", "episode_return")
_COLUMNS: Final = ("training", "unseen", "gap")
_HEAD: Final = ["agent", "trials", *(f"{what}, {name}" for what in ("goal", "return") for name in _COLUMNS)]


class Interval(NamedTuple):
    """A number and its 95 % interval."""

    value: float
    low: float
    high: float


class Summary(NamedTuple):
    """Mean goal rate and interquartile mean of the returns: on training levels, on unseen ones, the gap."""

    goal_rate: tuple[Interval, Interval, Interval]
    episode_return: tuple[Interval, Interval, Interval]


def summarise(document: dict[str, Any]) -> Summary:
    """Return what the trials of a result say, as `glue-generalise --out` wrote it.

    Raises:
        ExperimentError: SciPy is not installed.
    """
    trials = document["trials"]
    train, test = ([_scores(trials, levels, what) for what in _SCORES] for levels in ("train", "test"))
    goals, returns = zip(train, test, strict=True)
    return Summary(_compare(*goals, mean), _compare(*returns, interquartile_mean))


def table(documents: Sequence[dict[str, Any]]) -> str:
    """Return a table in Markdown, one row for each result."""
    rows = []
    for document in documents:
        summary = summarise(document)
        cells = [document["name"], str(len(document["trials"]))]
        cells += [_text(part, 3) for part in summary.goal_rate]
        cells += [_text(part, 1) for part in summary.episode_return]
        rows.append(f"| {' | '.join(cells)} |")
    head = [f"| {' | '.join(_HEAD)} |", f"| --- |{' ---: |' * (len(_HEAD) - 1)}"]
    return "\n".join([*head, *rows])


def _scores(trials: Sequence[dict[str, Any]], levels: str, what: str) -> FloatArray:
    """Return one kind of score, shape (levels, trials)."""
    return np.array([[score[what] for score in trial[levels]] for trial in trials], np.float64).T


def _compare(
    train: FloatArray, test: FloatArray, statistic: Statistic
) -> tuple[Interval, Interval, Interval]:
    rng = bootstrap_rng()
    values, samples = [], []
    for scores in (train, test):
        values.append(float(statistic(scores.ravel())))
        samples.append(np.array([statistic(_resampled(scores, rng).ravel()) for _ in range(_RESAMPLES)]))
    values.append(values[0] - values[1])
    samples.append(samples[0] - samples[1])
    first, second, gap = (
        Interval(value, *np.percentile(sample, _TAILS).tolist())
        for value, sample in zip(values, samples, strict=True)
    )
    return first, second, gap


def _resampled(scores: FloatArray, rng: np.random.Generator) -> FloatArray:
    levels, trials = scores.shape
    if trials == 1:
        drawn: FloatArray = scores[rng.integers(levels, size=levels)]
        return drawn
    resampled: FloatArray = np.take_along_axis(scores, rng.integers(trials, size=scores.shape), axis=1)
    return resampled


def _text(interval: Interval, digits: int) -> str:
    value, low, high = (f"{number:.{digits}f}" for number in interval)
    return f"{value} ({low} to {high})"
