"""The tables of messages are complete, and use RL-Glue's own numbers."""

from __future__ import annotations

import pytest

from glue.wire.messages import CALLS, CONTROL, OBSERVING, Body, Kind, Role

RL_GLUE = {
    "AGENT_INIT": 4,
    "AGENT_START": 5,
    "AGENT_STEP": 6,
    "AGENT_END": 7,
    "AGENT_CLEANUP": 8,
    "AGENT_MESSAGE": 10,
    "ENV_INIT": 11,
    "ENV_START": 12,
    "ENV_STEP": 13,
    "ENV_CLEANUP": 14,
    "ENV_MESSAGE": 19,
    "RL_INIT": 20,
    "RL_START": 21,
    "RL_STEP": 22,
    "RL_CLEANUP": 23,
    "RL_RETURN": 24,
    "RL_NUM_STEPS": 25,
    "RL_NUM_EPISODES": 26,
    "RL_EPISODE": 27,
    "RL_AGENT_MESSAGE": 33,
    "RL_ENV_MESSAGE": 34,
    "RL_ENV_START": 36,
    "RL_ENV_STEP": 37,
    "RL_AGENT_START": 38,
    "RL_AGENT_STEP": 39,
    "RL_AGENT_END": 40,
}
"""The message ids of RL-Glue 3.04, RL_network.h."""


def test_codes_below_64_are_rl_glues_own() -> None:
    assert {kind.name: kind.value for kind in Kind if kind < 64} == RL_GLUE


def test_every_kind_is_a_call_or_control_or_of_observers() -> None:
    assert len(CALLS) + len(CONTROL) + len(OBSERVING) == len(Kind)
    assert CALLS.keys() | CONTROL.keys() | OBSERVING.keys() == set(Kind)


@pytest.mark.parametrize("kind", CALLS)
def test_the_name_of_a_call_says_who_is_asked(kind: Kind) -> None:
    callee = {"ENV": Role.ENVIRONMENT, "AGENT": Role.AGENT, "RL": None}[kind.name.split("_")[0]]
    assert CALLS[kind].callee is callee


@pytest.mark.parametrize("kind", [kind for kind, call in CALLS.items() if call.callee is None])
def test_a_half_verb_carries_what_its_call_carries(kind: Kind) -> None:
    half = Kind.__members__.get(kind.name.removeprefix("RL_"))
    if half is not None:
        assert (CALLS[kind].request, CALLS[kind].reply) == (CALLS[half].request, CALLS[half].reply)


@pytest.mark.parametrize("kind", CALLS)
def test_what_goes_beyond_rl_glue_is_a_capability(kind: Kind) -> None:
    assert (CALLS[kind].capability is not None) == (kind > 64 and CALLS[kind].callee is not None)


def test_control_messages_have_no_body() -> None:
    assert {shape.body for shape in CONTROL.values()} == {Body.NONE}
