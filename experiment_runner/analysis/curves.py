"""Learning curves: running means over trials with bootstrap bands, at no more points than can be seen."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from experiment_runner.analysis.stats import Estimate, FloatArray, estimate, mean, running_mean

__all__ = ["Curve", "over_episodes", "over_steps"]

_POINTS: Final = 400


class Curve(NamedTuple):
    """A learning curve.

    at     (points,) the last episode of each running mean, or the steps that had been made after it
    means  (trials, points) the running mean of each trial
    band   their mean over trials and its 95 % interval, each (points,); NaN bounds for a single trial
    """

    at: FloatArray
    means: FloatArray
    band: Estimate


def over_episodes(
    returns: FloatArray,
    window: int,
    rng: np.random.Generator,
    span: tuple[float, float] = (-np.inf, np.inf),
) -> Curve | None:
    """Return the curve over episodes; None if no trial has as many as the window, or none in the span.

    Args:
        returns: (trials, episodes)
        window: episodes in the running mean.
        rng: for resampling.
        span: first and last episode that are of interest.

    Raises:
        ExperimentError: SciPy is not installed.
    """
    means = running_mean(returns, window)
    first = max(0, int(max(span[0], 0)) - window)
    last = min(means.shape[1] - 1, int(min(span[1], 2**53)) - window)
    if not means.size or last < first:
        return None
    shown = np.unique(np.linspace(first, last, _POINTS).astype(int))
    means = means[:, shown]
    return Curve((shown + window).astype(float), means, estimate([means], mean, rng))


def over_steps(
    returns: FloatArray,
    steps: Sequence[npt.NDArray[np.int64]],
    window: int,
    rng: np.random.Generator,
    span: tuple[float, float] = (-np.inf, np.inf),
) -> Curve | None:
    """Return the curve over steps, where all trials have a running mean; between episodes it is interpolated.

    Args:
        returns: (trials, episodes)
        steps: of each trial, the steps of its episodes, at least as many as there are returns.
        window, rng: as for `over_episodes`.
        span: first and last step that are of interest.

    Raises:
        ExperimentError: SciPy is not installed.
    """
    means = running_mean(returns, window)
    if not means.size:
        return None
    made = [np.cumsum(trial[: returns.shape[1]])[window - 1 :] for trial in steps]
    first = max(span[0], *(trial[0] for trial in made), 0)
    last = min(span[1], *(trial[-1] for trial in made), 2**63)
    if last < first:
        return None
    at = np.unique(np.linspace(first, last, _POINTS).round())
    drawn = np.array([np.interp(at, trial, line) for trial, line in zip(made, means, strict=True)])
    return Curve(at, drawn, estimate([drawn], mean, rng))
