"""Statistics of episode returns. Pure functions; random numbers come from a generator that is passed in.

Intervals are stratified percentile bootstrap intervals over trials: trials are resampled within each
setting (such as a level), never across settings. Source of the method: Agarwal et al. (2021), "Deep
Reinforcement Learning at the Edge of the Statistical Precipice". Their library, rliable, is not used: its
random_state has no effect. Neither is SciPy's `bootstrap`, whose numbers these are to the last bit: importing
it takes longer than showing a run. Only tests and tolerance intervals need SciPy (extra `plot`).

Comparison of two agents over the same trials, and the number of trials that a difference needs.

Source: Agarwal et al. (2021), "Deep Reinforcement Learning at the Edge of the Statistical Precipice":
interquartile means, the probability of improvement, performance profiles; Patterson et al. (2024), "Empirical
Design in Reinforcement Learning": tolerance intervals.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from glue.errors import ExperimentError
from glue.installed import needing

FloatArray = npt.NDArray[np.float64]
Statistic = Callable[..., Any]
"""A function of an array and `axis` that returns the array without that axis."""

FEW_TRIALS: Final = 5
"""Number of trials below which a bootstrap interval is too narrow to rely on."""

_CONFIDENCE: Final = 0.95
_RESAMPLES: Final = 2000
_SIMULATED: Final = 400
"""Number of comparisons that are simulated for each number of trials."""

_ELEMENTS_AT_ONCE: Final = 4_000_000  # of one batch of resamples, 32 MB


class Estimate(NamedTuple):
    """A statistic and its confidence interval: three arrays of the same shape, () for a single number."""

    value: FloatArray
    low: FloatArray
    high: FloatArray


def bootstrap_rng() -> np.random.Generator:
    """Return the generator for resampling, with a fixed seed: the same runs give the same interval."""
    return np.random.default_rng(0)


def mean_of_last(returns: FloatArray, window: int = 100) -> float:
    """Return the mean of the last `window` episode returns, or of all if there are fewer.

    Args:
        returns: (episodes,)
        window: at least 1.

    Returns:
        The mean; NaN if there are no episodes.
    """
    last = returns[-window:]
    return float(last.mean()) if last.size else math.nan


def running_mean(returns: FloatArray, window: int = 100) -> FloatArray:
    """Return the mean of every `window` consecutive returns.

    Args:
        returns: (..., episodes)
        window: at least 1.

    Returns:
        (..., episodes - window + 1), or (..., 0) if there are fewer than `window` episodes. Element i is the
        mean after episode i + window, where episodes count from 1.
    """
    if returns.shape[-1] < window:
        return np.empty((*returns.shape[:-1], 0))
    means: FloatArray = np.lib.stride_tricks.sliding_window_view(returns, window, axis=-1).mean(axis=-1)
    return means


def convergence_episode(returns: FloatArray, window: int = 100, tolerance: float = 2.0) -> int | None:
    """Return the first episode from which the running mean stays close to its final value.

    The running mean of `window` episodes has converged at episode e if from e on it stays within
    `tolerance` (in reward, inclusive) of its value at the last episode, for at least `window` further
    episodes, none of which are part of the mean at e. A curve that gets close only at its very end has
    not converged.

    Returns:
        The episode, counting from 1, so at least `window`; None if it has not converged.
    """
    means = running_mean(returns, window)
    if not means.size:
        return None
    far = np.flatnonzero(~(np.abs(means - means[-1]) <= tolerance))
    first = int(far[-1]) + 1 if far.size else 0
    return first + window if len(means) - 1 - first >= window else None


def mean(values: FloatArray, axis: int = 0) -> Any:
    """Return the mean along an axis."""
    return np.mean(values, axis=axis)


def interquartile_mean(values: FloatArray, axis: int = 0) -> Any:
    """Return the mean along an axis of the middle half: a quarter, rounded down, is trimmed at either end.

    Args:
        values: at least one along the axis; a NaN makes their mean NaN.
        axis: of the values.
    """
    values = np.moveaxis(values, axis, -1)
    count = values.shape[-1]
    cut = count // 4
    middle = np.partition(values, (cut, count - cut - 1))[..., cut : count - cut].mean(axis=-1)
    return np.where(np.isnan(values).any(axis=-1), np.nan, middle)[()]


def welch_p(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the p-value of Welch's t-test of equal means, along the last axis; 1 where nothing varies.

    Raises:
        ExperimentError: SciPy is not installed.
    """
    stats = _scipy_stats()
    with np.errstate(invalid="ignore", divide="ignore"), warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # of samples that are all equal
        found = stats.ttest_ind(a, b, axis=-1, equal_var=False).pvalue
    same = np.mean(a, axis=-1) == np.mean(b, axis=-1)
    return np.where(np.isnan(found), np.where(same, 1.0, 0.0), found)


def estimate(strata: Sequence[FloatArray], statistic: Statistic, rng: np.random.Generator) -> Estimate:
    """Return a statistic of the pooled trials, and its stratified 95 % bootstrap interval.

    Args:
        strata: one array (trials, ...) for each setting; they differ at most in the first axis.
        statistic: `mean`, `interquartile_mean` or the like, along an axis.
        rng: for resampling; the same state gives the same interval.

    Returns:
        Arrays of shape (...). Low and high are NaN if a stratum has fewer than two trials.
    """
    value = np.asarray(statistic(np.concatenate(strata), axis=0), np.float64)
    if min(len(stratum) for stratum in strata) < 2:
        return Estimate(value, np.full_like(value, np.nan), np.full_like(value, np.nan))
    at_once = max(1, _ELEMENTS_AT_ONCE // sum(stratum.size for stratum in strata))
    trials_last = [np.moveaxis(stratum, 0, -1) for stratum in strata]
    found = []
    with np.errstate(invalid="ignore"):  # returns may be infinite
        for first in range(0, _RESAMPLES, at_once):
            size = min(at_once, _RESAMPLES - first)
            drawn = [of[..., rng.integers(of.shape[-1], size=(size, of.shape[-1]))] for of in trials_last]
            found.append(statistic(np.concatenate(drawn, axis=-1), axis=-1))
        return Estimate(value, *_middle(np.concatenate(found, axis=-1)))


def _middle(found: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the ends of the middle 95 % of the values along the last axis; NaN if one of these is NaN."""
    count = found.shape[-1]
    ordered = np.sort(found, axis=-1)  # NaN last
    tail = (1 - _CONFIDENCE) / 2

    def end(quantile: float) -> FloatArray:  # interpolated linearly
        beyond, place = math.modf(quantile * count + (1 - quantile))  # counting from 1
        low, high = ordered[..., int(place) - 1], ordered[..., min(int(place), count - 1)]
        return np.where(np.isnan(ordered[..., -1]), np.nan, (1 - beyond) * low + beyond * high)

    return end(tail), end(1 - tail)


def _scipy_stats() -> Any:
    with needing("plot", "t-tests and tolerance intervals need SciPy", ExperimentError):
        from scipy import stats  # type: ignore[import-untyped]  # it has no types
    return stats


class Comparison(NamedTuple):
    """The comparison of two agents, a - b.

    difference   of their interquartile means, with its 95 % interval
    improvement  probability that a trial of a beats one of b, ties counted half, with its interval
    trials       number of trials of each agent
    """

    difference: Estimate
    improvement: Estimate
    trials: int


def compare(a: FloatArray, b: FloatArray, rng: np.random.Generator) -> Comparison:
    """Return the comparison of the performance of two agents in the same trials.

    The intervals are percentile bootstrap intervals. Trials are resampled in pairs, because both agents have
    the same seeds in a trial.

    Args:
        a, b: performance in each trial, shape (trials,), at least one; element i of both has the same seed.
        rng: for resampling.
    """
    chosen = rng.integers(len(a), size=(_RESAMPLES, len(a)))
    resampled = interquartile_mean(a[chosen], axis=1) - interquartile_mean(b[chosen], axis=1)
    difference = float(interquartile_mean(a) - interquartile_mean(b))
    ties = a[:, None] == b[None, :]  # of infinite values, too, whose difference is NaN
    better = (np.sign(np.where(ties, 0.0, a[:, None] - b[None, :])) + 1) / 2
    among = np.array([better[np.ix_(one, one)].mean() for one in chosen])
    return Comparison(
        with_interval(difference, resampled), with_interval(float(better.mean()), among), len(a)
    )


def with_interval(value: float, resampled: FloatArray) -> Estimate:
    """Return a statistic with the middle 95 % of its values in resampled trials, (resamples,)."""
    low, high = np.percentile(resampled, [2.5, 97.5])
    return Estimate(np.array(value), low, high)


def profile(values: FloatArray, thresholds: FloatArray) -> FloatArray:
    """Return the share of trials above each threshold, same shape as `thresholds`.

    Args:
        values: performance in each trial, shape (trials,).
        thresholds: any values.
    """
    shares: FloatArray = np.mean(values[:, None] > thresholds[None, :], axis=0)
    return shares


def tolerance_interval(values: FloatArray, share: float = 0.9) -> tuple[float, float]:
    """Return a distribution-free interval that contains a share of all trials, with a confidence of 95 %.

    Its ends are order statistics, chosen by the binomial distribution: the smallest symmetrical pair that
    reaches the confidence. NaN, NaN if there are too few trials for any pair.

    Args:
        values: performance in each trial, shape (trials,).
        share: of all trials, between 0 and 1, exclusive.

    Raises:
        ExperimentError: SciPy is not installed.

    Source: Wilks (1941), "Determination of sample sizes for setting tolerance limits".
    """
    outside = _trials_outside(len(values), share)
    if outside == 0:
        return math.nan, math.nan
    ordered = np.sort(values)
    return float(ordered[outside - 1]), float(ordered[len(values) - outside])


@cache
def _trials_outside(count: int, share: float) -> int:
    """Return k for the interval from the k-th smallest of `count` trials to the k-th greatest; 0 for none."""
    for outside in range(count // 2, 0, -1):
        # The interval spans count + 1 - 2 k spacings.
        if _scipy_stats().binom.cdf(count - 2 * outside, count, share) >= _CONFIDENCE:
            return outside
    return 0


def trials_needed(
    pilot: FloatArray,
    difference: float,
    rng: np.random.Generator,
    *,
    power: float = 0.8,
    most: int = 1000,
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
    """
    low, high = 1, most
    if _power(pilot, difference, high, rng) < power:
        return None
    while high - low > 1:
        middle = (low + high) // 2
        if _power(pilot, difference, middle, rng) < power:
            low = middle
        else:
            high = middle
    return high


def _power(pilot: FloatArray, difference: float, trials: int, rng: np.random.Generator) -> float:
    """Return the share of simulated comparisons of `trials` trials that detect the difference."""
    a, b = rng.choice(pilot, size=(2, _SIMULATED, trials))
    return float(np.mean(welch_p(a + difference, b) < 0.05))


def sensitivity(scores: FloatArray) -> tuple[float, int]:
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
