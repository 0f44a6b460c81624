"""Epsilon-greedy choice: probabilities, ties, decay, generator."""

from __future__ import annotations

from collections import Counter
from typing import cast

import numpy as np
import pytest

from agents.sarsa import Learner, below, epsilon_greedy, mix, seeded, uniform
from glue.compiled.records import Array, new

DRAWS = 4000


def chooser(epsilon: float, reduction: float = 1.0, cycles: int = 0) -> Learner:
    learners: Array = new(Learner)
    learners["epsilon"] = epsilon
    learners["reduction"] = reduction
    learners["cycles"] = cycles
    learners["random"] = seeded(7)
    return cast(Learner, learners[0])


def choices(chooser: Learner, values: list[float]) -> Counter[int]:
    """Return how often each value is chosen; two more values lie beyond the count."""
    array = np.array([*values, 99.0, 99.0])
    return Counter(epsilon_greedy(chooser, array, len(values)) for _ in range(DRAWS))


def test_without_exploration_the_greatest_value_is_chosen() -> None:
    assert choices(chooser(0.0), [0.5, 2.0, -1.0]) == {1: DRAWS}


def test_ties_are_broken_evenly_and_only_among_the_greatest() -> None:
    chosen = choices(chooser(0.0), [3.0, 1.0, 3.0, 2.0, 3.0])
    assert set(chosen) == {0, 2, 4}
    assert all(abs(chosen[i] - DRAWS / 3) < 150 for i in (0, 2, 4))


def test_exploration_is_even_over_all() -> None:
    chosen = choices(chooser(1.0), [3.0, 1.0, 2.0, 0.0])
    assert all(abs(chosen[i] - DRAWS / 4) < 150 for i in range(4))


def test_epsilon_shrinks_with_every_decision_cycle() -> None:
    """At epsilon 0.8 and reduction 0.5, one cycle leaves 0.4: the worse of two is chosen in 0.2 of cases."""
    for cycles, share in ((0, 0.4), (1, 0.2), (2, 0.1)):
        chosen = choices(chooser(0.8, 0.5, cycles), [1.0, 0.0])
        assert chosen[1] / DRAWS == pytest.approx(share, abs=0.025)
    assert choices(chooser(0.8, 0.5, 60), [1.0, 0.0]) == {0: DRAWS}


def test_where_nothing_is_to_choose_nothing_is_drawn() -> None:
    alone = chooser(1.0)
    before = int(alone["random"])  # type: ignore[index]
    assert epsilon_greedy(alone, np.array([1.0]), 1) == 0
    assert below(alone, 1) == 0
    assert int(alone["random"]) == before  # type: ignore[index]


def test_the_generator_is_splitmix64() -> None:
    """The first numbers for the seed 1234567, as published with the algorithm's reference code."""
    step = 0x9E3779B97F4A7C15
    published = (6457827717110365317, 3203168211198807973, 9817491932198370423, 4593380528125082431)
    for i, number in enumerate(published, 1):
        assert int(mix(np.uint64((1234567 + i * step) % 2**64))) == number


def test_uniform_draws_lie_in_the_unit_interval_and_spread_evenly() -> None:
    source = chooser(0.0)
    draws = [uniform(source) for _ in range(DRAWS)]
    assert all(0.0 <= draw < 1.0 for draw in draws)
    assert np.mean(draws) == pytest.approx(0.5, abs=0.02)
    assert np.var(draws) == pytest.approx(1 / 12, abs=0.01)
    assert draws[0] == (int(mix(np.uint64((int(seeded(7)) + 0x9E3779B97F4A7C15) % 2**64))) >> 11) / 2**53
