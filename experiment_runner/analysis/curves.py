"""Learning curves: running means over trials with bootstrap bands, at no more points than a plot can show."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np

from experiment_runner.analysis.stats import Estimate, FloatArray, estimate, mean, running_mean

_POINTS: Final = 400


class Curve(NamedTuple):
    """A learning curve.

    at     (points,) the last episode, or the last step, of each running mean
    means  (trials, points) the running mean of each trial
    band   their mean over trials and its 95 % interval, each (points,); NaN bounds for a single trial
    """

    at: FloatArray
    means: FloatArray
    band: Estimate


class StepTotals(NamedTuple):
    """The running total of a per-step value over a trial.

    steps   (n,) ascending from 0; between two of them every step has the same value
    totals  (n,) the sum of the values up to each of these steps, from 0
    """

    steps: FloatArray
    totals: FloatArray

    def mean(self, at: FloatArray, window: int) -> FloatArray:
        """Return the mean value of the `window` steps up to each step of `at`, same shape.

        Args:
            at: from `window` to the last of `steps`.
            window: at least 1.
        """
        ends, starts = (np.interp(places, self.steps, self.totals) for places in (at, at - window))
        means: FloatArray = (ends - starts) / window
        return means

    def last(self, window: int) -> float:
        """Return the mean value of the last `window` steps, or of all if there are fewer."""
        end = self.steps[-1:]
        return float(self.mean(end, min(window, int(end[0])))[0])


def step_returns(returns: FloatArray, steps: FloatArray) -> StepTotals:
    """Return totals of the return of the episode under way at each step.

    An episode without a return, such as one that the trial's budget of steps has cut off, counts with the
    return of the episode before it.

    Args:
        returns: of the finished episodes, (episodes,), at least one.
        steps: of all episodes, at least as many.

    Source: rlevaluation's `compute_step_return`; Patterson et al. (2024), "Empirical Design in Reinforcement
    Learning", section 3.
    """
    known = np.append(returns, np.full(len(steps) - len(returns), returns[-1]))
    return per_step(known * steps, steps)


def per_step(sums: FloatArray, steps: FloatArray) -> StepTotals:
    """Return totals of a value, given its sum over the steps of each episode.

    Args:
        sums: (episodes,)
        steps: of the same episodes.
    """
    return StepTotals(*(np.concatenate([[0.0], np.cumsum(values)]) for values in (steps, sums)))


def over_episodes(
    values: FloatArray, window: int, rng: np.random.Generator, span: tuple[float, float] = (-np.inf, np.inf)
) -> Curve | None:
    """Return the curve over episodes; None if no trial has as many as the window, or none in the span.

    Args:
        values: a measure of the episodes, (trials, episodes)
        window: episodes in the running mean.
        rng: for resampling.
        span: first and last episode of interest.
    """
    means = running_mean(values, window)
    begin, end = (int(min(max(episode, 0), 2**53)) for episode in span)
    first, last = max(0, begin - window), min(means.shape[1] - 1, end - window)
    if not means.size or last < first:
        return None
    shown = np.unique(np.linspace(first, last, _POINTS).astype(int))
    means = means[:, shown]
    return Curve((shown + window).astype(float), means, estimate([means], mean, rng))


def over_steps(
    totals: Sequence[StepTotals],
    window: int,
    rng: np.random.Generator,
    span: tuple[float, float] = (-np.inf, np.inf),
) -> Curve | None:
    """Return the curve over steps; None if a trial has fewer than the window, or none in the span.

    Args:
        totals: of each trial.
        window: steps in the running mean.
        rng: for resampling.
        span: first and last step of interest.
    """
    first = max(span[0], window)
    last = min(span[1], *(trial.steps[-1] for trial in totals), 2**63)
    if not totals or last < first:
        return None
    at = np.unique(np.linspace(first, last, _POINTS).round())
    means = np.array([trial.mean(at, window) for trial in totals])
    return Curve(at, means, estimate([means], mean, rng))


def of_metric(
    readings: Sequence[tuple[FloatArray, FloatArray]],
    rng: np.random.Generator,
    span: tuple[float, float] = (-np.inf, np.inf),
) -> Curve | None:
    """Return the curve of a metric over the steps that all trials cover, interpolated between readings.

    Args:
        readings: steps and values of each trial that has the metric.
        rng: for resampling.
        span: first and last step of interest.
    """
    known = [(steps[~np.isnan(values)], values[~np.isnan(values)]) for steps, values in readings]
    known = [(steps, values) for steps, values in known if steps.size]
    first = max(span[0], *(steps[0] for steps, _ in known), 0)
    last = min(span[1], *(steps[-1] for steps, _ in known), 2**63)
    if not known or last < first:
        return None
    at = np.unique(np.linspace(first, last, _POINTS).round())
    means = np.array([np.interp(at, steps, values) for steps, values in known])
    return Curve(at, means, estimate([means], mean, rng))
