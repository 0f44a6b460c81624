"""The tables of states of original programs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest

from glue.legacy.states import EXPERIMENT, PLAYER, ExperimentState, PlayerState, after

Table = Mapping[Any, Mapping[Any, Any]]


def reachable(table: Table, state: Any) -> set[Any]:
    """Return `state` and all that can follow it."""
    seen, new = set[Any](), {state}
    while new:
        seen |= new
        new = {following for known in new for following in table[known].values()} - seen
    return seen


@pytest.mark.parametrize(
    ("table", "states"), [(PLAYER, PlayerState), (EXPERIMENT, ExperimentState)], ids=["player", "experiment"]
)
def test_every_state_can_be_entered_and_ends_with_the_connection(table: Table, states: Any) -> None:
    assert reachable(table, states.IDLE) == table.keys() == set(states)
    for state in states:
        assert states.GONE in reachable(table, state)
    assert not table[states.GONE]


def test_what_cannot_happen_is_an_error() -> None:
    for table, states in ((PLAYER, PlayerState), (EXPERIMENT, ExperimentState)):
        for events in dict[Any, Any](table).values():
            for event in events:
                with pytest.raises(KeyError):
                    after(dict[Any, Any](table), states["GONE"], event)
