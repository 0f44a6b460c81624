"""Curves over steps: each step has the return of the episode under way."""

from __future__ import annotations

import numpy as np
import pytest

from experiment_runner.analysis.curves import over_steps, per_step, step_returns

RNG = np.random.default_rng(3)


@pytest.mark.parametrize("unfinished", [0, 1])
@pytest.mark.parametrize("window", [1, 7, 40])
def test_means_are_those_of_the_single_steps(unfinished: int, window: int) -> None:
    steps = RNG.integers(1, 12, size=30).astype(float)
    returns = RNG.normal(size=30 - unfinished)
    # Every step has a value, as rlevaluation's `compute_step_return` defines it.
    values = np.repeat([*returns, *[returns[-1]] * unfinished], steps.astype(int))
    at = np.arange(window, len(values) + 1, 3.0)
    expected = [values[int(end) - window : int(end)].mean() for end in at]
    np.testing.assert_allclose(step_returns(returns, steps).mean(at, window), expected)


def test_reward_per_step_of_a_continuing_task_is_its_rate() -> None:
    totals = per_step(np.array([30.0, 5.0]), np.array([10.0, 10.0]))
    np.testing.assert_allclose(totals.mean(np.array([10.0, 15.0, 20.0]), 10), [3.0, 1.75, 0.5])
    assert totals.last(1000) == 1.75


def test_the_curve_ends_with_the_shortest_trial() -> None:
    trials = [
        step_returns(np.array([1.0, 3.0]), np.array([2.0, 4.0])),
        step_returns(np.ones(2), np.array([4.0, 8.0])),
    ]
    curve = over_steps(trials, 2, RNG)
    assert curve is not None
    assert curve.at.tolist() == [2, 3, 4, 5, 6]
    np.testing.assert_allclose(curve.means, [[1, 2, 3, 3, 3], [1] * 5])
    assert over_steps(trials, 7, RNG) is None
    assert over_steps(trials, 2, RNG, (7, 9)) is None
