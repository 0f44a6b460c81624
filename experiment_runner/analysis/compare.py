"""Comparison of two agents over the same trials, and the number of trials that a difference needs.

Source: Agarwal et al. (2021), "Deep Reinforcement Learning at the Edge of the Statistical Precipice":
interquartile means, the probability of improvement, performance profiles; Patterson et al. (2024), "Empirical
Design in Reinforcement Learning": tolerance intervals.
"""

from __future__ import annotations

import math
from functools import cache
from typing import Final, NamedTuple

import numpy as np

from experiment_runner.analysis import stats

_RESAMPLES: Final = 2000


class Comparison(NamedTuple):
    """The comparison of two agents, a - b.

    difference   of their interquartile means, with its 95 % interval
    improvement  probability that a trial of a beats one of b, ties counted half, with its interval
    trials       number of trials of each agent
    """

    difference: stats.Estimate
    improvement: stats.Estimate
    trials: int


def compare(a: stats.FloatArray, b: stats.FloatArray, rng: np.random.Generator) -> Comparison:
    """Return the comparison of the performance of two agents in the same trials.

    The intervals are percentile bootstrap intervals. Trials are resampled in pairs, because both agents have
    the same seeds in a trial.

    Args:
        a, b: performance in each trial, shape (trials,), at least one; element i of both has the same seed.
        rng: for resampling.
    """
    chosen = rng.integers(len(a), size=(_RESAMPLES, len(a)))
    resampled = stats.interquartile_mean(a[chosen], axis=1) - stats.interquartile_mean(b[chosen], axis=1)
    difference = float(stats.interquartile_mean(a) - stats.interquartile_mean(b))
    better = (np.sign(a[:, None] - b[None, :]) + 1) / 2
    among = np.array([better[np.ix_(one, one)].mean() for one in chosen])
    return Comparison(_estimate(difference, resampled), _estimate(float(better.mean()), among), len(a))


def _estimate(value: float, resampled: stats.FloatArray) -> stats.Estimate:
    low, high = np.percentile(resampled, [2.5, 97.5])
    return stats.Estimate(np.array(value), low, high)


def profile(values: stats.FloatArray, thresholds: stats.FloatArray) -> stats.FloatArray:
    """Return the share of trials above each threshold, same shape as `thresholds`.

    Args:
        values: performance in each trial, shape (trials,).
        thresholds: any values.
    """
    shares: stats.FloatArray = np.mean(values[:, None] > thresholds[None, :], axis=0)
    return shares


def tolerance_interval(
    values: stats.FloatArray, share: float = 0.9, confidence: float = 0.95
) -> tuple[float, float]:
    """Return a distribution-free interval that contains a share of all trials with this confidence.

    Its ends are order statistics, chosen by the binomial distribution: the smallest symmetrical pair that
    reaches the confidence. NaN, NaN if there are too few trials for any pair.

    Args:
        values: performance in each trial, shape (trials,).
        share: of all trials, between 0 and 1, exclusive.
        confidence: between 0 and 1, exclusive.

    Raises:
        ExperimentError: SciPy is not installed.

    Source: Wilks (1941), "Determination of sample sizes for setting tolerance limits".
    """
    outside = _trials_outside(len(values), share, confidence)
    if outside == 0:
        return math.nan, math.nan
    ordered = np.sort(values)
    return float(ordered[outside - 1]), float(ordered[len(values) - outside])


@cache
def _trials_outside(count: int, share: float, confidence: float) -> int:
    """Return k for the interval from the k-th smallest of `count` trials to the k-th greatest; 0 for none."""
    for outside in range(count // 2, 0, -1):
        # The interval spans count + 1 - 2 k spacings.
        if stats.binomial_cdf(count - 2 * outside, count, share) >= confidence:
            return outside
    return 0


def trials_needed(
    pilot: stats.FloatArray,
    difference: float,
    rng: np.random.Generator,
    *,
    power: float = 0.8,
    most: int = 1000,
    resamples: int = 400,
) -> int | None:
    """Return the number of trials per agent needed to detect a difference; None if more than `most`.

    Two agents are simulated from the pilot, one of them better by the difference. The difference is detected
    if the 95 % interval of Welch's t-test excludes 0.

    Args:
        pilot: performance in each trial of a pilot run, shape (trials,), at least 2.
        difference: of the means, not 0.
        rng: for resampling.
        power: required probability of detecting the difference.
        most: largest number of trials considered.
        resamples: number of simulated comparisons for each number of trials.
    """
    low, high = 1, most
    if _power(pilot, difference, high, rng, resamples) < power:
        return None
    while high - low > 1:
        middle = (low + high) // 2
        if _power(pilot, difference, middle, rng, resamples) < power:
            low = middle
        else:
            high = middle
    return high


def _power(
    pilot: stats.FloatArray, difference: float, trials: int, rng: np.random.Generator, resamples: int
) -> float:
    """Return the share of simulated comparisons of `trials` trials that detect the difference."""
    a, b = rng.choice(pilot, size=(2, resamples, trials))
    return float(np.mean(stats.welch_p(a + difference, b) < 0.05))


def sensitivity(scores: stats.FloatArray) -> tuple[float, int]:
    """Return the sensitivity of an agent to its options, and the configuration that is best on average.

    The sensitivity is the loss, in normalised scores, from using one configuration for all environments
    instead of the best one for each. Scores are normalised in each environment by the 5th and 95th percentile
    of all.

    Args:
        scores: mean performance, shape (configurations, environments), at least two of each.

    Source: Adkins et al. (2024), "A Method for Evaluating Hyperparameter Sensitivity in Reinforcement
    Learning", equation 1.
    """
    low, high = np.percentile(scores, [5, 95], axis=0)
    normalised = (scores - low) / np.where(high > low, high - low, 1.0)
    on_average = normalised.mean(axis=1)
    return float(normalised.max(axis=0).mean() - on_average.max()), int(on_average.argmax())
