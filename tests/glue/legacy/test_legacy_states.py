"""State tables of original programs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from glue.legacy.states import EXPERIMENT, PLAYER, ExperimentState, PlayerState

Table = Mapping[Any, Mapping[Any, Any]]


def reachable(table: Table, state: Any) -> set[Any]:
    """Return `state` and all states that can follow it."""
    seen, new = set[Any](), {state}
    while new:
        seen |= new
        new = {following for known in new for following in table[known].values()} - seen
    return seen


TABLES: list[tuple[Table, Any, Any]] = [
    (PLAYER, PlayerState.IDLE, PlayerState.GONE),
    (EXPERIMENT, ExperimentState.IDLE, ExperimentState.GONE),
]


@pytest.mark.parametrize(("table", "first", "last"), TABLES, ids=["player", "experiment"])
def test_every_state_can_be_entered_and_ends_with_the_connection(table: Table, first: Any, last: Any) -> None:
    states: Any = type(first)
    assert reachable(table, first) == table.keys() == set(states)
    for state in table:
        assert last in reachable(table, state)
    assert not table[last]
