"""The value table and the update, computed by hand."""

from __future__ import annotations

from typing import cast

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given
from hypothesis import strategies as st

from agents.sarsa import (
    Keys,
    Learner,
    Taken,
    action_values,
    contents,
    extend,
    feature,
    grown,
    has_room,
    sum_of_values,
    table_of,
    take,
    update,
)
from glue.compiled.records import Array, new


def keys_of(*keys: int) -> Keys:
    return np.array(keys, np.uint64)


def empty() -> Array:
    return table_of(keys_of(), np.empty(0))


def learner(step_size: float = 0.3, learning: bool = True) -> Learner:
    learners = new(Learner)
    learners["step_size"] = step_size
    learners["learning"] = learning
    return cast(Learner, learners[0])


def taken(*keys: int) -> Taken:
    waiting = new(Taken)
    waiting["count"] = len(keys)
    waiting["keys"][0, : len(keys)] = keys
    return cast(Taken, waiting[0])


def values_of(table: Array) -> dict[int, float]:
    keys, values = contents(table)
    return dict(zip(keys.tolist(), values.tolist(), strict=True))


def test_a_value_moves_towards_its_target_by_the_step_size() -> None:
    table = empty()
    update(learner(), table, taken(5), 10.0)
    assert values_of(table) == {5: pytest.approx(0.3 * 10.0)}
    update(learner(), table, taken(5), 1.0)
    assert values_of(table) == {5: pytest.approx(3.0 + 0.3 * (1.0 - 3.0))}


def test_an_update_is_shared_out_equally_among_the_features() -> None:
    """The sum of 1 and 2 moves towards 6 by half of the difference, a quarter through each."""
    table = table_of(keys_of(5, 9), np.array([1.0, 2.0]))
    update(learner(0.5), table, taken(5, 9), 6.0)
    assert values_of(table) == {5: pytest.approx(1.75), 9: pytest.approx(2.75)}


def test_nothing_taken_nothing_learned() -> None:
    table = empty()
    update(learner(), table, taken(), 10.0)
    update(learner(learning=False), table, taken(5), 10.0)
    assert values_of(table) == {}


def test_the_value_of_an_action_is_the_sum_over_the_features_of_the_state() -> None:
    states = np.array([feature(1), feature(2)])
    table = table_of(
        np.array([extend(states[0], 1), extend(states[1], 1), extend(states[1], 2)]),
        np.array([1.0, 2.0, 4.0]),
    )
    values = np.full(3, np.nan)
    action_values(table, states, 2, values)
    assert values.tolist() == [0.0, 3.0, 4.0]
    waiting = new(Taken)
    take(cast(Taken, waiting[0]), states, 2, 1)
    assert waiting["count"][0] == 2
    assert waiting["keys"][0, :2].tolist() == [int(extend(state, 1)) for state in states]


def test_a_table_counts_its_entries_and_says_when_it_is_half_full() -> None:
    table = empty()
    one = learner()
    for key in range(1, 2049):
        assert has_room(one, table, 1)
        update(one, table, taken(key), 1.0)
        update(one, table, taken(key), 1.0)
    assert not has_room(one, table, 1)
    larger = grown(table)
    assert len(larger) == 2 * len(table)
    assert has_room(one, larger, 1)
    assert values_of(larger) == values_of(table)
    assert len(values_of(larger)) == 2048


@given(st.dictionaries(st.integers(1, 2**64 - 1), st.floats(-1e6, 1e6), max_size=200))
def test_a_table_finds_every_value_and_nothing_else(values: dict[int, float]) -> None:
    keys = keys_of(*values)
    numbers: npt.NDArray[np.float64] = np.array(list(values.values()), np.float64)
    table = table_of(keys, numbers)
    assert values_of(table) == values
    for key, value in values.items():
        assert sum_of_values(table, keys_of(key), 1) == value
    strange = next(key for key in range(1, 300) if key not in values)
    assert sum_of_values(table, keys_of(strange), 1) == 0.0


def test_keys_that_collide_in_the_table_keep_their_own_values() -> None:
    size = len(empty())
    table = table_of(keys_of(3, 3 + size, 3 + 2 * size, 4), np.array([1.0, 2.0, 3.0, 4.0]))
    assert [sum_of_values(table, keys_of(key), 1) for key in (3, 3 + size, 3 + 2 * size, 4)] == [1, 2, 3, 4]


@given(st.lists(st.lists(st.integers(-50, 50), min_size=1, max_size=4).map(tuple), unique=True, max_size=60))
def test_different_rows_of_numbers_have_different_keys(rows: list[tuple[int, ...]]) -> None:
    keys = set()
    for first, *others in rows:
        key = feature(first)
        for number in others:
            key = extend(np.uint64(key), number)
        keys.add(int(key))
    assert len(keys) == len(rows)
