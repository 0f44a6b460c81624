"""The tabular agent says which tasks it cannot play."""

from __future__ import annotations

import hashlib

import pytest

from agents.tabular import SarsaAgent
from env_server.toys import MinesEnvironment
from glue import LocalProtocolError, Observation, local
from tests.players import returns

_SPEC = "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1 OBSERVATIONS {} ACTIONS {} REWARDS (0 1)"


@pytest.mark.parametrize(
    ("task_spec", "complaint"),
    [
        ("VERSION Private-1 text", "observation is one int with bounds; this one has none$"),
        (_SPEC.format("", "INTS (0 3)"), "observation is one int with bounds; this one has none$"),
        (_SPEC.format("INTS (2 0 9)", "INTS (0 3)"), r"observation .*; this one has INTS \(2 0 9\)$"),
        (_SPEC.format("DOUBLES (4 -1 1)", "INTS (0 1)"), "the agent linear learns from numbers$"),
        (_SPEC.format("INTS (0 9)", "INTS (0 UNSPEC)"), r"action .*; this one has INTS \(0 UNSPEC\)$"),
    ],
)
def test_task_that_is_not_one_int_for_one_int_is_refused(task_spec: str, complaint: str) -> None:
    with pytest.raises(LocalProtocolError, match=complaint):
        SarsaAgent().agent_init(task_spec)


def test_values_that_are_no_numbers_are_a_clear_error() -> None:
    agent = SarsaAgent(epsilon=0.0)
    agent.agent_init(_SPEC.format("INTS (0 0)", "INTS (0 0)"))
    agent.agent_start(Observation(ints=[0]))
    agent.agent_end(float("nan"))
    with pytest.raises(LocalProtocolError, match="what was learned is NaN"):
        agent.agent_start(Observation(ints=[0]))


def test_the_table_learns_the_same_to_the_last_bit() -> None:
    # As recorded when the table used NumPy.
    with local(SarsaAgent(epsilon=0.2), MinesEnvironment()) as glue:
        glue.rl_init(seed=1)
        assert (sum(returns(glue, 100, 1000)), glue.rl_num_steps()) == (-13848.0, 95)
        saved = hashlib.sha256(glue.rl_agent_save()).hexdigest()
        assert saved == "d4dac3fb62664dae32806c25fe02b23f0e2a33e87d290b6e0772a88e78816ef1"
