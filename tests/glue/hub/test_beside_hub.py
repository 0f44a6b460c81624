"""What stands beside observations, at the hub: what the kit's rules for hubs leave open."""

from __future__ import annotations

import pytest

from glue.types import Action, Observation
from glue.wire.messages import ErrorCode, Kind, Role
from tests.glue.hub.test_sessions import ACTION, Rig, check_error, error

FULL = Observation([3], mask=[True, False], extras={"coins": 1})
BARE = FULL.without(mask=True, extras=True)
MASKED = FULL.without(extras=True)

MASK, BOTH = ("mask",), ("mask", "extras")


def filled(**abilities: tuple[str, ...]) -> Rig:
    """Return a rig whose environment has both capabilities, if it is not given others."""
    rig = Rig()
    rig.fill(**{"environment": BOTH, **abilities})
    return rig


@pytest.mark.parametrize("offered", [(), MASK, ("extras",), BOTH])
def test_an_experiment_and_an_observer_get_what_they_read(offered: tuple[str, ...]) -> None:
    rig = filled(experiment=offered)
    welcome, *_ = rig.hello("o", Role.OBSERVER, abilities=offered)
    assert welcome.scalars[5:] == ((tuple(sorted(offered)),) if offered else ())
    rig.put("o", Kind.OBSERVE, 0, 9)
    read = FULL.without(mask="mask" not in offered, extras="extras" not in offered).body
    rig.ask(Kind.RL_START, 1)
    rig.answer("e", body=FULL.body)
    rig.answer("a", body=ACTION)
    assert [message.body for message in rig.received("x")] == [read + ACTION]
    assert [message.body for message in rig.received("o")] == [read]
    rig.ask(Kind.RL_ENV_STEP, 2, body=Action([9]).body)
    rig.answer("e", body=FULL.body)
    assert [message.body for message in rig.received("x")] == [read]
    assert [message.body for message in rig.received("o")] == [read + Action([9]).body]


def test_a_call_is_repeated_as_the_agent_reads_it() -> None:
    rig = filled(agent=MASK)
    rig.ask(Kind.RL_START, 1)
    rig.answer("e", body=FULL.body)
    call = rig.called("a")
    rig.cut("a")
    _, again = rig.hello("a2", Role.AGENT, who="a", abilities=MASK)
    assert again == call


def test_the_hub_accounts_for_the_agents_copy_of_a_large_observation() -> None:
    rig = filled(agent=MASK)
    rig.ask(Kind.RL_START, 1)
    before = rig.sessions.memory.total
    rig.answer("e", body=Observation(chars=bytes(100_000), extras={"a": 1}).body)
    assert rig.sessions.memory.total - before >= 200_000


def test_what_one_agent_reads_another_in_its_place_need_not() -> None:
    rig = filled(agent=MASK)
    rig.ask(Kind.RL_ENV_START, 1)
    rig.answer("e", body=MASKED.body)
    rig.cut("a")
    rig.hello("b", Role.AGENT)
    rig.ask(Kind.RL_START, 2)
    rig.answer("e", body=MASKED.body)
    assert rig.called("b").body == BARE.body


def test_a_mask_of_the_experiments_own_allows_the_environment_none() -> None:
    rig = filled(agent=MASK, environment=())
    rig.ask(Kind.RL_AGENT_START, 1, body=MASKED.body)
    rig.answer("a")
    rig.ask(Kind.RL_ENV_START, 2)
    rig.answer("e", body=MASKED.body)
    assert error(rig.received("e"))[0] == ErrorCode.UNSUPPORTED
    check_error(rig.received("x"), ErrorCode.PEER_FAILED, "it sent mask with ENV_START")
