"""Statistics of episode returns. Pure functions; random numbers come from a generator that is passed in.

Intervals are stratified percentile bootstrap intervals over trials: trials are resampled within each
setting (such as a level), never across settings. Source of the method: Agarwal et al. (2021), "Deep
Reinforcement Learning at the Edge of the Statistical Precipice". Their library, rliable, is not used: its
random_state has no effect. Neither is SciPy's `bootstrap`, whose numbers these are to the last bit: importing
it takes longer than showing a run. Only tests and tolerance intervals need SciPy (extra `plot`).
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from glue.errors import ExperimentError

FloatArray = npt.NDArray[np.float64]
Statistic = Callable[..., Any]
"""A function of an array and `axis` that returns the array without that axis."""

FEW_TRIALS: Final = 5
"""Number of trials below which a bootstrap interval is too narrow to rely on."""

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


def binomial_cdf(k: int, n: int, p: float) -> float:
    """Return the probability that a binomial variable of `n` draws is at most `k`.

    Raises:
        ExperimentError: SciPy is not installed.
    """
    return float(_scipy_stats().binom.cdf(k, n, p))


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


def estimate(
    strata: Sequence[FloatArray],
    statistic: Statistic,
    rng: np.random.Generator,
    *,
    confidence: float = 0.95,
    resamples: int = 2000,
) -> Estimate:
    """Return a statistic of the pooled trials, and its stratified bootstrap interval.

    Args:
        strata: one array (trials, ...) for each setting; they differ at most in the first axis.
        statistic: `mean`, `interquartile_mean` or the like, along an axis.
        rng: for resampling; the same state gives the same interval.
        confidence: level of the interval, between 0 and 1, exclusive.
        resamples: number of resamples.

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
        for first in range(0, resamples, at_once):
            size = min(at_once, resamples - first)
            drawn = [of[..., rng.integers(of.shape[-1], size=(size, of.shape[-1]))] for of in trials_last]
            found.append(statistic(np.concatenate(drawn, axis=-1), axis=-1))
        return Estimate(value, *_middle(np.concatenate(found, axis=-1), confidence))


def _middle(found: FloatArray, share: float) -> tuple[FloatArray, FloatArray]:
    """Return the ends of the middle share of the values along the last axis; NaN if one of these is NaN."""
    count = found.shape[-1]
    ordered = np.sort(found, axis=-1)  # NaN last
    tail = (1 - share) / 2

    def end(quantile: float) -> FloatArray:  # interpolated linearly
        beyond, place = math.modf(quantile * count + (1 - quantile))  # counting from 1
        low, high = ordered[..., int(place) - 1], ordered[..., min(int(place), count - 1)]
        return np.where(np.isnan(ordered[..., -1]), np.nan, (1 - beyond) * low + beyond * high)

    return end(tail), end(1 - tail)


def _scipy_stats() -> Any:
    try:
        from scipy import stats  # type: ignore[import-untyped]  # it has no types
    except ImportError:
        raise ExperimentError(
            "t-tests and tolerance intervals need SciPy: pip install 'glue-rl[plot]'"
        ) from None
    return stats
