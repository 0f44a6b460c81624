"""Comparisons against SciPy, against counting, and against simulated coverage."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import scipy  # type: ignore[import-untyped]  # it has no types

from experiment_runner.analysis.stats import compare, profile, sensitivity, tolerance_interval, trials_needed

RNG = np.random.default_rng(11)


def test_the_difference_and_the_probability_are_those_of_their_definitions() -> None:
    a, b = RNG.normal(1.0, size=9), RNG.normal(size=9)
    b[2] = a[4]  # a tie
    found = compare(a, b, np.random.default_rng(0))
    assert found.difference.value == pytest.approx(
        scipy.stats.trim_mean(a, 0.25) - scipy.stats.trim_mean(b, 0.25)
    )
    wins = [(x > y) + (x == y) / 2 for x, y in itertools.product(a, b)]
    assert found.improvement.value == pytest.approx(np.mean(wins))
    assert scipy.stats.mannwhitneyu(a, b).statistic / 81 == pytest.approx(found.improvement.value)
    assert found.improvement.low <= found.improvement.value <= found.improvement.high
    backwards = compare(b, a, np.random.default_rng(0))
    assert backwards.difference.low == pytest.approx(-found.difference.high)
    assert backwards.improvement.value == pytest.approx(1 - found.improvement.value)


@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
def test_equal_infinite_returns_are_ties() -> None:
    a = np.array([-np.inf, -np.inf, 1.0])
    assert compare(a, a, np.random.default_rng(0)).improvement.value == 0.5


def test_intervals_of_equal_agents_cover_no_difference() -> None:
    covered = 0
    for number in range(20):
        rng = np.random.default_rng(number)
        shared = rng.normal(size=30)  # the seed's effect on both agents
        found = compare(shared + rng.normal(size=30), shared + rng.normal(size=30), rng)
        covered += bool(found.difference.low <= 0 <= found.difference.high)
    assert covered >= 15  # of 20, where 19 are expected


def test_a_profile_is_the_share_above_each_threshold() -> None:
    assert profile(np.array([1.0, 2.0, 2.0, 5.0]), np.array([0.0, 2.0, 5.0])).tolist() == [1.0, 0.25, 0.0]


@pytest.mark.parametrize(("count", "share"), [(59, 0.9), (93, 0.95), (30, 0.75)])
def test_a_tolerance_interval_has_the_confidence_of_the_beta_distribution(count: int, share: float) -> None:
    ordered = np.arange(float(count))
    low, high = tolerance_interval(RNG.permutation(ordered), share)
    spacings = high - low
    assert scipy.stats.beta.sf(share, spacings, count - spacings + 1) >= 0.95
    inner = spacings - 2
    assert scipy.stats.beta.sf(share, inner, count - inner + 1) < 0.95


def test_too_few_trials_have_no_tolerance_interval() -> None:
    assert np.isnan(tolerance_interval(np.arange(10.0))).all()


def test_the_trials_needed_are_those_of_the_t_test() -> None:
    pilot = RNG.normal(size=2000)
    found = trials_needed(pilot, 1.0, np.random.default_rng(0))
    assert found is not None
    assert 13 <= found <= 22  # 17 for a normal distribution, Cohen (1988), table 2.4.1
    assert trials_needed(pilot, 0.01, np.random.default_rng(0), most=50) is None


def test_sensitivity_is_the_loss_of_one_configuration_for_all_environments() -> None:
    same = np.array([[0.0, 0.0], [1.0, 10.0], [0.5, 5.0]])
    loss, best = sensitivity(same)
    assert loss == pytest.approx(0.0)
    assert best == 1
    opposed = np.array([[1.0, 0.0], [0.0, 1.0]])
    loss, _ = sensitivity(opposed)
    assert loss == pytest.approx(0.5 / 0.9)  # each is best once and worst once
