from __future__ import annotations

import math
import sys
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
import scipy  # type: ignore[import-untyped]  # it has no types
from hypothesis import given
from hypothesis import strategies as st

from experiment_runner.analysis import stats
from glue.errors import ExperimentError

FloatArray = npt.NDArray[np.float64]


def array(*values: float) -> FloatArray:
    return np.array(values, np.float64)


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def test_mean_of_last_takes_what_there_is() -> None:
    assert stats.mean_of_last(array(1, 2, 3, 4), window=2) == 3.5
    assert stats.mean_of_last(array(1, 2), window=100) == 1.5
    assert math.isnan(stats.mean_of_last(array()))


def test_running_mean_of_one_trial_and_of_several() -> None:
    assert stats.running_mean(array(1, 3, 5, 10), window=2).tolist() == [2, 4, 7.5]
    assert stats.running_mean(array(4, 5), window=2).tolist() == [4.5]
    assert stats.running_mean(array(1), window=2).shape == (0,)
    assert stats.running_mean(np.array([[1.0, 3.0, 5.0], [0.0, 0.0, 6.0]]), window=2).tolist() == [
        [2, 4],
        [0, 3],
    ]
    assert stats.running_mean(np.ones((7, 3)), window=4).shape == (7, 0)


def test_running_mean_forgets_what_is_past() -> None:
    # A running sum would carry the infinity, or the rounding error of 1e300, to the end.
    assert stats.running_mean(array(math.inf, 1, 2, 3), window=2).tolist()[1:] == [1.5, 2.5]
    assert stats.running_mean(array(1e300, 1, 2, 3), window=2).tolist()[1:] == [1.5, 2.5]


def test_returns_that_end_with_none_have_not_converged() -> None:
    assert stats.convergence_episode(array(1, 1, 1, math.nan), window=2, tolerance=2) is None


@given(st.lists(st.integers(-5, 5), max_size=40), st.integers(1, 6))
def test_convergence_follows_its_rule(values: list[int], window: int) -> None:
    means = {e: sum(values[e - window : e]) / window for e in range(window, len(values) + 1)}
    final = means.get(len(values), math.nan)
    stays = [
        e
        for e in means
        if all(abs(means[f] - final) <= 2 for f in means if f >= e) and len(values) - e >= window
    ]
    found = stats.convergence_episode(array(*values), window=window, tolerance=2)
    assert found == (min(stays) if stays else None)


@pytest.mark.parametrize("count", [1, 3, 4, 11])
@pytest.mark.parametrize("odd", [0.0, math.inf, math.nan])
def test_interquartile_mean_is_that_of_scipy(count: int, odd: float) -> None:
    values = rng(4).normal(100, 30, (count, 5))
    values[0, 2] = odd
    for axis in (0, 1):
        with np.errstate(invalid="ignore"):
            expected = scipy.stats.trim_mean(values, 0.25, axis=axis)
            found = stats.interquartile_mean(values, axis=axis)
        np.testing.assert_allclose(found, expected, rtol=1e-15)


@pytest.mark.parametrize("tail", [(), (200,)])
def test_interval_is_that_of_scipy(tail: tuple[int, ...]) -> None:
    strata = [rng(4).normal(100, 30, (5, *tail)), rng(5).normal(0, 9, (2, *tail))]

    def pooled(*samples: FloatArray, axis: int) -> Any:
        return stats.interquartile_mean(np.concatenate(samples, axis=axis), axis=axis)

    how: Any = {"vectorized": True, "method": "percentile", "rng": rng(6)}
    expected = scipy.stats.bootstrap(strata, pooled, n_resamples=2000, **how).confidence_interval
    value, low, high = stats.estimate(strata, stats.interquartile_mean, rng(6))
    np.testing.assert_array_equal(value, pooled(*strata, axis=0))
    # SciPy before 1.17 interpolates with other rounding errors.
    np.testing.assert_allclose((low, high), expected, rtol=1e-14)


def test_interval_of_long_curves_does_not_depend_on_how_they_are_batched() -> None:
    # 5000 points of ten trials are resampled in batches, a single point in one go.
    curves = rng(5).normal(size=(10, 5000))
    long, short = (stats.estimate([c], stats.mean, rng(6)) for c in (curves, curves[:, :1]))
    assert (long.low[0], long.high[0]) == (short.low[0], short.high[0])


def test_one_trial_has_no_interval() -> None:
    value, low, high = stats.estimate([array(7)], stats.mean, rng())
    assert value == 7
    assert np.isnan(low)
    assert np.isnan(high)
    assert np.isnan(stats.estimate([array(7), array(1, 2)], stats.mean, rng()).low)


def test_infinite_returns_are_no_error() -> None:
    value, low, high = stats.estimate([array(math.inf, 1, 2)], stats.mean, rng())
    assert value == math.inf
    assert high == math.inf
    assert 1 <= low <= 2


def test_missing_scipy_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "scipy", None)
    with pytest.raises(ExperimentError, match=r"need SciPy: pip install 'glue-rl\[plot\]'"):
        stats.welch_p(array(1, 2), array(3, 5))
