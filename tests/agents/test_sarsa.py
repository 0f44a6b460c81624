"""The value table and the update, computed by hand."""

from __future__ import annotations

from typing import cast

import numpy as np
import numpy.typing as npt
from hypothesis import given
from hypothesis import strategies as st

from agents import sarsa
from glue.compiled.records import Array, new


def keys_of(*keys: int) -> sarsa.Keys:
    return np.array(keys, np.uint64)


def empty() -> Array:
    return sarsa.table_of(keys_of(), np.empty(0))


def learner() -> sarsa.Learner:
    learners = new(sarsa.Learner)
    learners["step_size"] = 0.3
    learners["learning"] = True
    return cast(sarsa.Learner, learners[0])


def taken(*keys: int) -> sarsa.Taken:
    waiting = new(sarsa.Taken)
    waiting["count"] = len(keys)
    waiting["keys"][0, : len(keys)] = keys
    return cast(sarsa.Taken, waiting[0])


def values_of(table: Array) -> dict[int, float]:
    keys, values = sarsa.contents(table)
    return dict(zip(keys.tolist(), values.tolist(), strict=True))


def test_the_value_of_an_action_is_the_sum_over_the_features_of_the_state() -> None:
    states = np.array([sarsa.feature(1), sarsa.feature(2)])
    table = sarsa.table_of(
        np.array([sarsa.extend(states[0], 1), sarsa.extend(states[1], 1), sarsa.extend(states[1], 2)]),
        np.array([1.0, 2.0, 4.0]),
    )
    values = np.full(3, np.nan)
    sarsa.action_values(table, states, 2, values)
    assert values.tolist() == [0.0, 3.0, 4.0]
    waiting = new(sarsa.Taken)
    sarsa.take(cast(sarsa.Taken, waiting[0]), states, 2, 1)
    assert waiting["count"][0] == 2
    assert waiting["keys"][0, :2].tolist() == [int(sarsa.extend(state, 1)) for state in states]


def test_a_table_counts_its_entries_and_says_when_it_is_half_full() -> None:
    table = empty()
    one = learner()
    for key in range(1, 2049):
        assert sarsa.has_room(one, table, 1)
        sarsa.update(one, table, taken(key), 1.0)
        sarsa.update(one, table, taken(key), 1.0)
    assert not sarsa.has_room(one, table, 1)
    larger = sarsa.grown(table)
    assert len(larger) == 2 * len(table)
    assert sarsa.has_room(one, larger, 1)
    assert values_of(larger) == values_of(table)
    assert len(values_of(larger)) == 2048


@given(st.dictionaries(st.integers(1, 2**64 - 1), st.floats(-1e6, 1e6), max_size=200))
def test_a_table_finds_every_value_and_nothing_else(values: dict[int, float]) -> None:
    keys = keys_of(*values)
    numbers: npt.NDArray[np.float64] = np.array(list(values.values()), np.float64)
    table = sarsa.table_of(keys, numbers)
    assert values_of(table) == values
    for key, value in values.items():
        assert sarsa.sum_of_values(table, keys_of(key), 1) == value
    strange = next(key for key in range(1, 300) if key not in values)
    assert sarsa.sum_of_values(table, keys_of(strange), 1) == 0.0


def test_keys_that_collide_in_the_table_keep_their_own_values() -> None:
    size = len(empty())
    keys = (3, 3 + size, 3 + 2 * size, 4)
    table = sarsa.table_of(keys_of(*keys), np.array([1.0, 2.0, 3.0, 4.0]))
    assert [sarsa.sum_of_values(table, keys_of(key), 1) for key in keys] == [1, 2, 3, 4]


@given(st.lists(st.lists(st.integers(-50, 50), min_size=1, max_size=4).map(tuple), unique=True, max_size=60))
def test_different_rows_of_numbers_have_different_keys(rows: list[tuple[int, ...]]) -> None:
    keys = set()
    for first, *others in rows:
        key = sarsa.feature(first)
        for number in others:
            key = sarsa.extend(np.uint64(key), number)
        keys.add(int(key))
    assert len(keys) == len(rows)
