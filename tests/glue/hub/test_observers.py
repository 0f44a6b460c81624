"""Observers of a session, without sockets: the messages that they receive; they can change nothing."""

from __future__ import annotations

from typing import Any

import pytest

from glue.hub.observers import MAX_OBSERVERS
from glue.types import Action
from glue.wire.messages import CALLS, THREE_ROLES, ErrorCode, Kind, Message, Role, Shape
from tests.glue.hub.test_sessions import ACTION, OBSERVATION, Rig, check_error, error

EMPTY = Action().body


@pytest.fixture
def rig() -> Rig:
    rig = Rig()
    rig.fill()
    return rig


def shown(rig: Rig, channel: str = "o") -> list[tuple[Any, ...]]:
    """Return the messages sent to an observer: kind, number, scalars and body of each."""
    return [(m.kind, m.seq, m.scalars, m.body) for m in rig.received(channel)]


def watch(rig: Rig, moments: int, channel: str = "o") -> list[Message]:
    """Let in an observer that wants `moments` moments; return the messages that it receives at once."""
    welcome, *told = rig.hello(channel, Role.OBSERVER)
    assert (welcome.kind, welcome.scalars[1]) == (Kind.WELCOME, False)
    rig.put(channel, Kind.OBSERVE, 0, moments)
    return told


def play(rig: Rig, seq: int, max_steps: int = 3) -> None:
    """Play an episode that is cut off."""
    rig.carry_out(Kind.RL_EPISODE, seq, max_steps)
    assert rig.received("x")[-1].kind is Kind.RL_EPISODE


def test_an_observer_is_shown_the_task_spec_starts_and_steps_with_their_counters(rig: Rig) -> None:
    watch(rig, 100)
    rig.carry_out(Kind.RL_INIT, 1, None)
    play(rig, 2)
    play(rig, 3, 2)
    assert shown(rig) == [
        (Kind.OBSERVED_INIT, 0, (), b"spec"),
        (Kind.OBSERVED_START, 1, (1,), OBSERVATION),
        (Kind.OBSERVED_STEP, 2, (1, 2, 1.0, 1.0, False), OBSERVATION + ACTION),
        (Kind.OBSERVED_STEP, 3, (1, 3, 2.0, 1.0, False), OBSERVATION + ACTION),
        (Kind.OBSERVED_START, 4, (2,), OBSERVATION),
        (Kind.OBSERVED_STEP, 5, (2, 2, 1.0, 1.0, False), OBSERVATION + ACTION),
    ]


def test_who_comes_late_is_told_the_task_spec_and_shown_the_rest_of_the_episode(rig: Rig) -> None:
    rig.carry_out(Kind.RL_INIT, 1, None)
    rig.carry_out(Kind.RL_START, 2)
    (spec,) = watch(rig, 1)
    assert (spec.kind, spec.seq, spec.body) == (Kind.OBSERVED_INIT, 0, b"spec")
    rig.ask(Kind.RL_STEP, 3)
    rig.answer("e", 5.0, True)
    rig.serve()
    assert shown(rig) == [
        (Kind.OBSERVED_STEP, 1, (0, 1, 5.0, 5.0, True), OBSERVATION + ACTION),
    ]


def test_half_steps_are_shown_with_the_action_that_they_carry(rig: Rig) -> None:
    watch(rig, 9)
    rig.carry_out(Kind.RL_ENV_START, 1)
    other = Action(ints=[77]).body
    rig.carry_out(Kind.RL_ENV_STEP, 2, body=other)
    assert [one[3] for one in shown(rig)] == [OBSERVATION, OBSERVATION + other]


def test_a_step_without_a_start_shows_the_empty_action(rig: Rig) -> None:
    watch(rig, 1)
    rig.carry_out(Kind.RL_STEP, 1)
    assert [one[3] for one in shown(rig)] == [OBSERVATION + EMPTY]


def test_no_more_moments_are_shown_than_are_wanted_and_the_numbers_tell_what_was_missed(rig: Rig) -> None:
    watch(rig, 2)
    play(rig, 1, 10)
    assert [one[:2] for one in shown(rig)] == [(Kind.OBSERVED_START, 1), (Kind.OBSERVED_STEP, 2)]
    rig.put("o", Kind.OBSERVE, 0, 1)
    play(rig, 2, 2)
    assert [one[:2] for one in shown(rig)] == [(Kind.OBSERVED_START, 11)]
    rig.put("o", Kind.OBSERVE, 0, 5)
    rig.put("o", Kind.OBSERVE, 0, 0)
    play(rig, 3, 2)
    assert shown(rig) == []


def test_what_an_observer_does_not_read_is_missed_and_no_peer_notices(rig: Rig) -> None:
    watch(rig, 100)
    rig.full.add("o")
    rig.carry_out(Kind.RL_INIT, 1, None)
    play(rig, 2, 4)
    rig.full.remove("o")
    play(rig, 3, 2)
    assert [one[:2] for one in shown(rig)] == [
        (Kind.OBSERVED_INIT, 0),
        (Kind.OBSERVED_START, 5),
        (Kind.OBSERVED_STEP, 6),
    ]


def test_what_the_agent_answers_to_the_experiment_is_told_whoever_wants_it(rig: Rig) -> None:
    watch(rig, 0)
    rig.carry_out(Kind.RL_AGENT_MESSAGE, 1, body=b"values\n\xff")
    rig.carry_out(Kind.RL_ENV_MESSAGE, 2, body=b"level 7")
    assert shown(rig) == [(Kind.OBSERVED_MESSAGE, 1, ("values \ufffd",), b"agent answer")]


def test_an_observer_takes_no_role_and_opens_no_session() -> None:
    rig = Rig()
    code, text = error(rig.hello("o", Role.OBSERVER))
    assert (code, text) == (ErrorCode.NO_SESSION, "there is no session 's' yet; say HELLO again later")
    rig.fill()
    assert rig.hello("o", Role.OBSERVER)[0].kind is Kind.WELCOME
    assert rig.received("x") == [], "nobody is told of it"
    for channel in ("x", "a", "e"):
        rig.put(channel, Kind.GOODBYE, 0, "done")
    (goodbye,) = rig.received("o")
    assert (goodbye.kind, goodbye.scalars) == (Kind.GOODBYE, ("the session is over",))
    assert error(rig.hello("p", Role.OBSERVER))[0] == ErrorCode.NO_SESSION


@pytest.mark.parametrize("role", THREE_ROLES)
def test_an_observer_cannot_take_a_role_over_its_connection(rig: Rig, role: Role) -> None:
    assert rig.hello("o", Role.OBSERVER)[0].kind is Kind.WELCOME
    assert error(rig.hello("o", role)) == (
        ErrorCode.MALFORMED,
        "this connection is already the observer of the session",
    )
    again = rig.hello("o", Role.OBSERVER)
    assert [(m.kind, m.scalars[1]) for m in again] == [(Kind.WELCOME, True)]
    assert error(rig.hello("a", Role.OBSERVER))[0] == ErrorCode.MALFORMED


def message(kind: Kind, shape: Shape, seq: int) -> Message:
    """Return some message of a kind."""
    examples: dict[type, Any] = {float: 1.0, bool: False, int: 1, str: "x"}
    body = {"text": b"x", "bytes": b"x"}.get(shape.body.name.lower(), OBSERVATION)
    return Message(kind, "s", seq, tuple(examples[s.type] for s in shape.scalars), body)


@pytest.mark.parametrize("kind", [*CALLS, Kind.ERROR])
@pytest.mark.parametrize("seq", [0, 1, 2, 3, 99])
def test_nothing_that_an_observer_sends_changes_anything(kind: Kind, seq: int) -> None:
    """During RL_START the observer sends every call, answer and error, also with the awaited number."""
    rig = Rig()
    rig.fill()
    watch(rig, 0)
    rig.ask(Kind.RL_START, 1)
    assert rig.answer("e") is Kind.ENV_START
    shape = CALLS[kind].reply if kind in CALLS else Shape()
    if kind in CALLS and CALLS[kind].callee is None:
        shape = CALLS[kind].request
    sent = message(kind, shape, seq)
    if kind is Kind.ERROR:
        sent = sent._replace(scalars=("exception", "it failed"))
    assert rig.sessions.receive(rig.channel("o"), sent, rig.now) is False
    assert all(m.kind is Kind.ERROR and m.scalars[0] == ErrorCode.NOT_ASKED for m in rig.received("o"))
    assert rig.received("x") == []
    assert [m.kind for m in rig.inbox["a"]] == [Kind.AGENT_START]
    assert rig.answer("a") is Kind.AGENT_START
    assert [m.kind for m in rig.received("x")] == [Kind.RL_START]


@pytest.mark.parametrize("channel", ["a", "e", "x"])
def test_who_takes_part_cannot_ask_to_be_shown_anything(rig: Rig, channel: str) -> None:
    check_error(rig.say(channel, Kind.OBSERVE, 0, 5), ErrorCode.NOT_ASKED, "OBSERVE is not for this ")


def test_a_session_has_so_many_observers_and_those_that_are_gone_make_room(rig: Rig) -> None:
    for number in range(MAX_OBSERVERS):
        watch(rig, 1, f"o{number}")
    code, text = error(rig.hello("late", Role.OBSERVER))
    assert (code, text) == (ErrorCode.FULL, f"session 's' has {MAX_OBSERVERS} observers, the maximum")
    rig.cut("o0")
    assert rig.hello("late", Role.OBSERVER)[0].kind is Kind.WELCOME
    play(rig, 1, 2)
    assert [one[0] for one in shown(rig, "o1") if one[0] is not Kind.HEARTBEAT] == [Kind.OBSERVED_START]


def test_an_observer_that_leaves_or_is_lost_is_forgotten(rig: Rig) -> None:
    watch(rig, 9, "o")
    watch(rig, 9, "p")
    rig.put("o", Kind.GOODBYE, 0, "seen enough")
    rig.lose("p")
    play(rig, 1, 2)
    assert shown(rig, "o") == shown(rig, "p") == []
    assert rig.sessions.num_sessions(rig.channel("o")) == rig.sessions.num_sessions(rig.channel("p")) == 0
    assert [m.kind for m in rig.received("x")] == []
