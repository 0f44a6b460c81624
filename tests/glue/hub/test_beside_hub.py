"""What stands beside observations, at the hub: each peer gets what it reads, and no agent gets extras."""

from __future__ import annotations

from typing import Any

import pytest

from glue.types import Action, Observation
from glue.wire.messages import ErrorCode, Kind, Message, Role
from tests.glue.hub.test_sessions import ACTION, Rig

FULL = Observation([3], mask=[True, False], extras={"coins": 1})
BARE = FULL.without(mask=True, extras=True)
MASKED = FULL.without(extras=True)

BOTH = ("mask", "extras")


def filled(agent: tuple[str, ...] = (), experiment: tuple[str, ...] = (), environment: Any = BOTH) -> Rig:
    rig = Rig()
    for channel, role, offered in (
        ("a", Role.AGENT, agent),
        ("e", Role.ENVIRONMENT, environment),
        ("x", Role.EXPERIMENT, experiment),
    ):
        rig.hello(channel, role, abilities=offered)
    rig.received("x")
    return rig


def show(rig: Rig, observation: Observation, *scalars: Any) -> Message:
    """Answer the environment's one call with an observation; return the next call to the agent."""
    (call,) = rig.received("e")
    rig.put("e", call.kind, call.seq, *scalars, body=observation.body)
    (next_call,) = rig.received("a")
    return next_call


@pytest.mark.parametrize(
    ("offered", "seen"), [((), BARE), (("mask",), MASKED), (BOTH, MASKED)], ids=["none", "mask", "both"]
)
def test_no_agent_sees_extras_and_one_without_the_capability_no_mask(
    offered: tuple[str, ...], seen: Observation
) -> None:
    rig = filled(agent=offered)
    rig.ask(Kind.RL_START, 1)
    start = show(rig, FULL)
    assert (start.kind, start.body) == (Kind.AGENT_START, seen.body)
    rig.put("a", start.kind, start.seq, body=ACTION)
    rig.ask(Kind.RL_STEP, 2)
    assert show(rig, FULL, 1.0, False).body == seen.body


@pytest.mark.parametrize("offered", [(), ("mask",), ("extras",), BOTH])
def test_an_experiment_and_an_observer_get_what_they_read(offered: tuple[str, ...]) -> None:
    rig = filled(experiment=offered)
    welcome, *_ = rig.hello("o", Role.OBSERVER, abilities=offered)
    assert welcome.scalars[5:] == ((tuple(sorted(offered)),) if offered else ())
    rig.put("o", Kind.OBSERVE, 0, 9)
    read = FULL.without(mask="mask" not in offered, extras="extras" not in offered).body
    rig.ask(Kind.RL_START, 1)
    start = show(rig, FULL)
    rig.put("a", start.kind, start.seq, body=ACTION)
    assert [message.body for message in rig.received("x")] == [read + ACTION]
    assert [message.body for message in rig.received("o")] == [read]
    rig.ask(Kind.RL_ENV_STEP, 2, body=Action([9]).body)
    (call,) = rig.received("e")
    rig.put("e", call.kind, call.seq, 1.0, False, body=FULL.body)
    assert [message.body for message in rig.received("x")] == [read]
    assert [message.body for message in rig.received("o")] == [read + Action([9]).body]


def test_an_experiments_own_observation_reaches_the_agent_without_extras() -> None:
    rig = filled(agent=("mask",))
    rig.ask(Kind.RL_AGENT_START, 1, body=FULL.body)
    (call,) = rig.received("a")
    assert call.body == MASKED.body


@pytest.mark.parametrize(("offered", "what"), [((), "mask"), (("mask",), "extras"), (("extras",), "mask")])
def test_an_environment_that_sends_what_it_has_not_offered_has_failed(offered: Any, what: str) -> None:
    rig = filled(environment=offered)
    rig.ask(Kind.RL_START, 1)
    (call,) = rig.received("e")
    rig.put("e", call.kind, call.seq, body=FULL.body)
    (error,) = rig.received("e")
    assert error.scalars[0] == ErrorCode.UNSUPPORTED
    (failed,) = rig.received("x")
    assert failed.scalars[0] == ErrorCode.PEER_FAILED
    assert f"it sent {what} with ENV_START" in str(failed.scalars[1])
    assert rig.received("a") == []


def test_a_call_is_repeated_as_the_agent_reads_it() -> None:
    rig = filled(agent=("mask",))
    rig.ask(Kind.RL_START, 1)
    call = show(rig, FULL)
    rig.cut("a")
    _, again = rig.hello("a2", Role.AGENT, who="a", abilities=("mask",))
    assert again == call


def test_the_hub_accounts_for_the_agents_copy_of_a_large_observation() -> None:
    rig = filled(agent=("mask",))
    rig.ask(Kind.RL_START, 1)
    before = rig.sessions.memory.total
    show(rig, Observation(chars=bytes(100_000), extras={"a": 1}))
    assert rig.sessions.memory.total - before >= 200_000


def test_what_one_agent_reads_another_in_its_place_need_not() -> None:
    rig = filled(agent=("mask",))
    rig.ask(Kind.RL_ENV_START, 1)
    (call,) = rig.received("e")
    rig.put("e", call.kind, call.seq, body=MASKED.body)
    rig.cut("a")
    rig.hello("b", Role.AGENT)
    rig.ask(Kind.RL_START, 2)
    (call,) = rig.received("e")
    rig.put("e", call.kind, call.seq, body=MASKED.body)
    (call,) = rig.received("b")
    assert call.body == BARE.body


def test_a_mask_of_the_experiments_own_allows_the_environment_none() -> None:
    rig = filled(agent=("mask",), environment=())
    rig.ask(Kind.RL_AGENT_START, 1, body=MASKED.body)
    (call,) = rig.received("a")
    rig.put("a", call.kind, call.seq, body=ACTION)
    rig.ask(Kind.RL_ENV_START, 2)
    (call,) = rig.received("e")
    rig.put("e", call.kind, call.seq, body=MASKED.body)
    (error,) = rig.received("e")
    assert error.scalars[0] == ErrorCode.UNSUPPORTED
