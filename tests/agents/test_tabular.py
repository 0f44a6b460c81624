"""The tabular agent says which tasks it cannot play."""

from __future__ import annotations

import pytest

from agents.tabular import SarsaAgent
from glue.errors import LocalProtocolError

_SPEC = "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1 OBSERVATIONS {} ACTIONS {} REWARDS (0 1)"


@pytest.mark.parametrize(
    ("task_spec", "complaint"),
    [
        ("VERSION Private-1 text", "observation is one int with bounds; this one has none$"),
        (_SPEC.format("", "INTS (0 3)"), "observation is one int with bounds; this one has none$"),
        (_SPEC.format("INTS (2 0 9)", "INTS (0 3)"), r"observation .*; this one has INTS \(2 0 9\)$"),
        (_SPEC.format("INTS (0 9)", "INTS (0 UNSPEC)"), r"action .*; this one has INTS \(0 UNSPEC\)$"),
    ],
)
def test_task_that_is_not_one_int_for_one_int_is_refused(task_spec: str, complaint: str) -> None:
    with pytest.raises(LocalProtocolError, match=complaint):
        SarsaAgent().agent_init(task_spec)
