"""An environment that does not wait for its agent, in the session of a hub, by a clock set by hand."""

from __future__ import annotations

import pytest

from glue.hub.config import HubConfig, TimeLimits
from glue.pace import Pace
from glue.types import Action, Observation
from glue.wire.messages import ErrorCode, Event, Kind, Message, Role
from tests.glue.hub.test_sessions import Rig, check_error, error, notices
from tests.hubs import over_the_hub
from tests.players import ScriptedAgent, ScriptedEnvironment
from tests.weighing import check_sessions

TIME = TimeLimits(step_seconds=1.0, bank_seconds=3.0)


def action(number: int) -> bytes:
    return Action([number]).body


def observation(number: int) -> bytes:
    return Observation([number]).body


def calls(rig: Rig, channel: str) -> list[Message]:
    """Return the calls that a player has received, without heartbeats."""
    return [message for message in rig.received(channel) if message.kind is not Kind.HEARTBEAT]


def begun(
    pace: Pace, *abilities: str, time: TimeLimits | None = None, experiment: tuple[str, ...] = ()
) -> Rig:
    """Return a rig in an RL_episode: the agent has answered its start with action 100.

    The first step is due at once, and has been asked for.
    """
    rig: Rig = Rig(HubConfig(heartbeat=1.0, timeout=5.0, time=time, pace=pace))
    rig.fill(agent=abilities, experiment=experiment)
    rig.carry_out(Kind.RL_INIT, 1, None)
    rig.ask(Kind.RL_EPISODE, 2, 0)
    rig.answer("e")
    rig.wait(3.0)
    rig.answer("a", body=action(100))
    return rig


def step(rig: Rig, number: int, terminal: bool = False) -> bytes:
    """Let the environment make the step that it was asked for; return the action that it carries out."""
    call = rig.called("e")
    assert call.kind is Kind.ENV_STEP
    rig.put("e", call.kind, call.seq, 1.0, terminal, body=observation(number))
    return call.body


def asked(*abilities: str) -> tuple[Rig, Message]:
    """Return a rig whose agent has been asked for an action after the first step, and this call."""
    rig = begun(Pace(rate=10.0), *abilities)
    step(rig, 1)
    return rig, rig.called("a")


def test_an_action_that_comes_in_time_is_carried_out_when_its_step_is_due() -> None:
    rig = begun(Pace(rate=10.0))
    assert step(rig, 1) == action(100)
    rig.wait(0.0625)
    call = rig.called("a")
    assert (call.kind, call.scalars, call.body) == (Kind.AGENT_STEP, (1.0,), observation(1))
    rig.put("a", call.kind, call.seq, body=action(101))
    assert calls(rig, "e") == []  # not yet
    rig.wait(0.0625)
    assert step(rig, 2) == action(101)
    assert rig.sessions.num_late("s") == 0


def test_a_late_agents_call_stays_outstanding_and_its_answer_is_carried_out_next() -> None:
    rig, first = asked()
    for number in (2, 3, 4):
        rig.wait(0.1)
        assert step(rig, number) == action(100)
    assert calls(rig, "a") == []
    rig.put("a", first.kind, first.seq, body=action(101))
    second = rig.called("a")  # at once: the newest observation, and the sum of the rewards since the first
    assert (second.scalars, second.body) == ((3.0,), observation(4))
    rig.wait(0.1)
    assert step(rig, 5) == action(101)
    rig.put("a", second.kind, second.seq, body=action(104))
    rig.wait(0.1)
    assert step(rig, 6) == action(104)
    assert rig.sessions.num_late("s") == 5  # two of them not chosen for the newest observation


@pytest.mark.parametrize(("experiment", "told"), [((), (3,)), (("pace",), (3, 2))])
def test_an_experiment_with_the_capability_is_told_how_many_actions_were_late(
    experiment: tuple[str, ...], told: tuple[int, ...]
) -> None:
    rig = begun(Pace(rate=10.0), experiment=experiment)
    step(rig, 1)
    rig.wait(0.1)
    step(rig, 2)
    rig.answer("a")
    rig.wait(0.1)
    step(rig, 3, terminal=True)
    assert [rig.answer("a"), rig.answer("a")] == [Kind.AGENT_STEP, Kind.AGENT_END]
    rig.received("x")
    (reply,) = rig.say("x", Kind.RL_NUM_STEPS, 3)
    assert reply.scalars == told


def test_a_welcome_confirms_the_pace_to_experiments_where_there_is_one() -> None:
    for pace, confirmed in ((Pace(rate=10.0), [(("mask", "pace"),)]), (Pace(), [(("mask",),)])):
        rig: Rig = Rig(HubConfig(pace=pace))
        (welcome,) = rig.hello("x", Role.EXPERIMENT, abilities=("mask", "pace"))[:1]
        assert [welcome.scalars[5:]] == confirmed
        for role in (Role.OBSERVER, Role.AGENT):
            (welcome,) = rig.hello(role, role, abilities=("mask", "pace"))[:1]
            assert welcome.scalars[5:] == (("mask",),)


def test_an_episode_that_ends_while_the_agent_is_late_waits_for_its_answer() -> None:
    rig, late = asked()
    rig.wait(0.1)
    step(rig, 2, terminal=True)
    assert calls(rig, "a") == calls(rig, "x") == []
    rig.put("a", late.kind, late.seq, body=action(101))
    end = rig.called("a")
    assert (end.kind, end.scalars) == (Kind.AGENT_END, (1.0,))
    (reply,) = rig.say("a", end.kind, end.seq) or rig.received("x")
    assert (reply.kind, reply.scalars) == (Kind.RL_EPISODE, (True,))


def test_an_agent_with_the_capability_is_told_its_deadline_and_latency() -> None:
    rig, call = asked("pace")
    assert list(call.scalars) == pytest.approx([1.0, 0.1, 3.0])
    rig.wait(0.05)
    rig.put("a", call.kind, call.seq, body=action(101))
    rig.wait(0.05)
    rig.wait(0.02)  # the environment takes its time
    step(rig, 2)
    assert list(rig.called("a").scalars) == pytest.approx([1.0, 0.08, 0.05])


def test_an_agent_that_returns_is_sent_its_outstanding_call_again() -> None:
    rig, call = asked()
    rig.cut("a")
    for number in (2, 3):
        rig.wait(0.1)
        step(rig, number)
    welcome, again = rig.hello("a2", Role.AGENT, "a")
    assert welcome.scalars[1] is True
    assert again == call  # not the newest: that one it is given next
    rig.put("a2", call.kind, call.seq, body=action(101))
    assert rig.called("a2").body == observation(3)


def test_an_agent_that_is_lost_voids_the_episode_and_another_takes_its_place() -> None:
    rig = begun(Pace(rate=10.0))
    step(rig, 1)
    rig.lose("a")
    assert error([m for m in rig.received("x") if m.kind is Kind.ERROR])[0] == ErrorCode.PEER_LOST
    rig.wait(1.0)
    assert not [call for call in calls(rig, "e") if call.kind is Kind.ENV_STEP]  # nothing is due any more
    rig.hello("b", Role.AGENT)
    rig.ask(Kind.RL_EPISODE, 3, 0)
    rig.answer("e")
    assert [rig.answer("b"), rig.answer("b")] == [Kind.AGENT_INIT, Kind.AGENT_START]
    assert step(rig, 1) == Action([4]).body


def test_an_environment_that_is_lost_ends_the_agents_call_too() -> None:
    rig, late = asked()
    rig.wait(0.1)
    rig.lose("e")
    rig.received("x")
    rig.put("a", late.kind, late.seq, body=action(101))  # to an episode that is void
    assert calls(rig, "a") == calls(rig, "x") == []
    rig.hello("e2", Role.ENVIRONMENT)
    rig.ask(Kind.RL_START, 3)
    assert [rig.answer("e2"), rig.answer("e2")] == [Kind.ENV_INIT, Kind.ENV_START]
    assert rig.called("a").kind is Kind.AGENT_START


def test_an_answer_to_another_call_is_refused() -> None:
    rig, call = asked()
    (refusal,) = rig.say("a", Kind.AGENT_END, call.seq)
    assert refusal.scalars == ("not-asked", "AGENT_END was answered; AGENT_STEP was asked")
    assert error(rig.received("x"))[0] == ErrorCode.PEER_FAILED


def test_an_agent_that_raises_fails_the_verb() -> None:
    rig, call = asked()
    rig.put("a", Kind.ERROR, call.seq, "exception", "no idea")
    assert error(rig.received("x")) == (ErrorCode.PEER_FAILED, "agent a raised in agent_step: no idea")


def test_a_late_agent_has_its_time_limit_all_the_same() -> None:
    rig = begun(Pace(rate=2.0), time=TIME)
    number = 0
    while not (failure := [message for message in rig.received("x") if message.kind is Kind.ERROR]):
        number += 1
        step(rig, number)
        rig.wait(0.5)
        rig.sessions.tick(rig.now)
    assert number == 5  # one second is free, the bank has three, and the start has taken two of them
    check_error(failure, ErrorCode.PEER_FAILED, "a ran out of time")


def test_a_late_agent_is_reported_as_slow() -> None:
    rig = begun(Pace(rate=1.0))
    for number in range(1, 8):
        step(rig, number)
        rig.wait(1.0)
        rig.sessions.tick(rig.now)
    assert notices(rig.received("x")) == [(Event.SLOW, "agent")]
    assert "a has not answered agent_step for 5 s" in rig.logged[-1]


def test_a_message_between_two_steps_waits_for_the_agent() -> None:
    rig = begun(Pace(rate=10.0))
    # in an episode made step by step
    step(rig, 1, terminal=True)
    rig.answer("a")
    rig.carry_out(Kind.RL_START, 3)
    rig.received("x")
    rig.ask(Kind.RL_STEP, 4)
    step(rig, 1)
    late = rig.called("a")
    rig.wait(0.1)
    assert rig.received("x")[0].kind is Kind.RL_STEP
    rig.ask(Kind.RL_AGENT_MESSAGE, 5, body=b"well?")
    assert calls(rig, "a") == []
    rig.put("a", late.kind, late.seq, body=action(101))
    assert rig.called("a").body == b"well?"


@pytest.mark.parametrize("size", [10, 100_000])
def test_delayed_actions_are_part_of_the_memory(size: int) -> None:
    rig = begun(Pace(delay=50))
    for number in range(60):
        step(rig, number)
        rig.answer("a", body=Action([1], chars=bytes(size)).body)
        check_sessions(rig.sessions)


def test_a_batch_has_no_pace() -> None:
    rig: Rig = Rig(HubConfig(pace=Pace(rate=10.0)))
    rig.fill(agent=("batch",), environment=("batch",))
    rig.ask(Kind.RL_INIT, 1, None)
    rig.answer("e")
    check_error(rig.received("x"), ErrorCode.UNSUPPORTED, "no rate and no delay")


@pytest.mark.parametrize(("pace", "late"), [(Pace(delay=1), 0), (Pace(), None)])
def test_an_experiment_elsewhere_knows_how_many_actions_were_late(pace: Pace, late: int | None) -> None:
    with over_the_hub(ScriptedAgent([]), ScriptedEnvironment(3, 1.0, []), pace=pace) as glue:
        glue.rl_init()
        assert glue.rl_episode()
        assert (glue.late_actions(), glue.rl_num_steps()) == (late, 3)
