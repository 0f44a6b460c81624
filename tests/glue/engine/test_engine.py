"""The meaning of RL-Glue's calls in all corner cases. Source: RL-Glue 3.04, RL_glue.c and its behaviour."""

from __future__ import annotations

from typing import Any

import pytest

from glue.engine.engine import Engine, Instruction, role_seed
from glue.engine.local import LocalExperiment, local
from glue.errors import LocalProtocolError, PeerLost, RemoteProtocolError
from glue.types import CUT_OFF, Action, Observation
from glue.wire.messages import CALLS, Kind, Role
from tests.players import ScriptedAgent, ScriptedEnvironment, SeededAgent, SeededEnvironment

ANSWERS: dict[Kind, tuple[tuple[Any, ...], Any]] = {
    Kind.ENV_INIT: ((), "spec"),
    Kind.ENV_START: ((), "o0"),
    Kind.ENV_STEP: ((1.0, False), "o"),
    Kind.ENV_MESSAGE: ((), "env answer"),
    Kind.AGENT_START: ((), "a0"),
    Kind.AGENT_STEP: ((), "a"),
    Kind.AGENT_MESSAGE: ((), "agent answer"),
}
"""Answers of players whose episodes never end; bodies are names, since the engine never reads them."""

NEVER_ENDS = (1.0, False)
ENDS = (1.0, True)


def go_on(
    engine: Engine, step: Instruction, env_step: tuple[float, int] = NEVER_ENDS
) -> tuple[list[str], Instruction]:
    """Answer calls from `step` on until the verb is done; return the calls made and the reply."""
    made = []
    while engine.awaiting is not None:
        made.append(step.kind.name)
        scalars, body = ANSWERS.get(step.kind, ((), None))
        step = engine.resume(step.kind, env_step if step.kind is Kind.ENV_STEP else scalars, body)
    return made, step


def drive(
    engine: Engine, verb: Kind, *scalars: Any, body: Any = b"", env_step: tuple[float, int] = NEVER_ENDS
) -> tuple[list[str], Instruction]:
    """Carry `verb` out; return the calls made and the reply."""
    return go_on(engine, engine.begin(verb, scalars, body), env_step)


def initialised(seed: int | None = None) -> Engine:
    engine = Engine("empty action")
    drive(engine, Kind.RL_INIT, seed)
    return engine


def asked_for_a_step() -> Engine:
    engine = initialised()
    drive(engine, Kind.RL_START)
    engine.begin(Kind.RL_STEP)
    return engine


def play(length: int = 3, reward: float = 1.0) -> tuple[LocalExperiment, list[str]]:
    """Return an experiment in one process, and the list that records the calls of both players."""
    calls: list[str] = []
    return local(ScriptedAgent(calls), ScriptedEnvironment(length, reward, calls)), calls


def counters(glue: LocalExperiment) -> tuple[int, int, float]:
    return glue.rl_num_steps(), glue.rl_num_episodes(), glue.rl_return()


# RL_init


def test_init_with_an_empty_spec_after_another_yields_the_empty_one() -> None:
    # The original would answer with the old one: a quirk that is not worth imitating.
    environment = ScriptedEnvironment()
    glue = local(ScriptedAgent(), environment)
    glue.rl_init()
    environment.task_spec = ""
    assert glue.rl_init() == ""


def test_init_sets_the_counters_only_when_both_have_answered() -> None:
    engine = initialised()
    drive(engine, Kind.RL_START)
    step = engine.begin(Kind.RL_INIT, (None,))
    step = engine.resume(Kind.ENV_INIT, (), "spec")
    assert (step.kind, engine.num_steps) == (Kind.AGENT_INIT, 1)
    engine.resume(Kind.AGENT_INIT, (), None)
    assert (engine.num_steps, engine.num_episodes, engine.total_reward) == (0, 0, 0.0)


def test_init_twice_runs_both_inits_again_and_keeps_the_last_action() -> None:
    glue, calls = play()
    glue.rl_init()
    glue.rl_start()
    glue.rl_init()
    assert counters(glue) == (0, 0, 0.0)
    calls.clear()
    glue.rl_step()
    assert calls[0] == "env_step [100]"


# RL_start


def test_start_sets_the_counters_before_it_asks_the_environment() -> None:
    engine = initialised()
    drive(engine, Kind.RL_START)
    drive(engine, Kind.RL_STEP)
    engine.begin(Kind.RL_START)
    assert (engine.num_steps, engine.total_reward) == (1, 0.0)


# Counters


def test_return_and_counters_are_kept_after_the_end_and_after_cleanup() -> None:
    glue, _ = play(length=2, reward=-0.5)
    glue.rl_init()
    glue.rl_episode()
    assert counters(glue) == (2, 1, -1.0)
    glue.rl_cleanup()
    assert counters(glue) == (2, 1, -1.0)


def test_reward_is_summed_undiscounted_in_the_order_of_the_steps() -> None:
    rewards = iter([1e16, 1.0, -1e16, 1.0])

    class Rewarding(ScriptedEnvironment):
        def env_step(self, action: Action) -> tuple[float, Observation, bool]:
            return next(rewards), Observation(), False

    glue = local(ScriptedAgent(), Rewarding())
    glue.rl_init()
    glue.rl_episode(5)
    assert glue.rl_return() == ((1e16 + 1.0) - 1e16) + 1.0


# Messages and cleanup


def test_cleanup_is_the_environment_first_and_may_come_early_and_twice() -> None:
    glue, calls = play()
    glue.rl_cleanup()
    glue.rl_cleanup()
    assert calls == ["env_cleanup", "agent_cleanup"] * 2


# Half steps


def test_half_steps_do_not_touch_the_last_action() -> None:
    glue, calls = play(length=9)
    glue.rl_init()
    glue.rl_start()
    glue.rl_env_start()
    glue.rl_env_step(Action(ints=[7]))
    glue.rl_agent_start(Observation(ints=[50]))
    glue.rl_agent_step(0.0, Observation(ints=[51]))
    calls.clear()
    glue.rl_step()
    assert calls[0] == "env_step [100]", "what RL_start left"


# The engine itself


@pytest.mark.parametrize("kind", [kind for kind, call in CALLS.items() if call.callee is not None])
def test_a_call_to_a_player_is_no_verb(kind: Kind) -> None:
    with pytest.raises(LocalProtocolError, match=kind.name):
        Engine(b"").begin(kind)


def test_a_verb_before_the_last_is_done_is_an_error_that_names_both() -> None:
    engine = initialised()
    engine.begin(Kind.RL_START)
    with pytest.raises(
        LocalProtocolError, match="RL_STEP was called while RL_START is still being carried out"
    ):
        engine.begin(Kind.RL_STEP)
    assert engine.awaiting is Kind.ENV_START


def test_an_answer_to_another_call_is_an_error_and_changes_nothing() -> None:
    engine = initialised()
    engine.begin(Kind.RL_START)
    with pytest.raises(RemoteProtocolError, match="AGENT_START was answered; ENV_START was asked"):
        engine.resume(Kind.AGENT_START, (), "a")
    _, reply = go_on(engine, engine.resume(Kind.ENV_START, (), "o0"))
    assert reply.kind is Kind.RL_START


def test_an_answer_to_nothing_is_an_error() -> None:
    with pytest.raises(RemoteProtocolError, match="nothing was asked"):
        initialised().resume(Kind.ENV_START, (), "o")


def test_after_an_abort_the_next_verb_begins_afresh() -> None:
    engine = asked_for_a_step()
    engine.abort()
    assert (engine.awaiting, engine.verb, engine.asked) == (None, None, None)
    assert drive(engine, Kind.RL_STEP)[0] == ["ENV_STEP", "AGENT_STEP"]


# Seeds


def test_the_seed_reaches_each_player_before_its_init_and_each_another() -> None:
    calls: list[str] = []
    glue = local(SeededAgent(calls), SeededEnvironment(calls=calls))
    glue.rl_init(seed=7)
    env_seed, agent_seed = role_seed(7, Role.ENVIRONMENT), role_seed(7, Role.AGENT)
    assert calls == [f"env_seed {env_seed}", "env_init", f"agent_seed {agent_seed}", "agent_init a task"]
    assert env_seed != agent_seed


def test_role_seeds_are_fixed_for_ever() -> None:
    # Published results of others depend on these.
    assert {
        (seed, role): role_seed(seed, role)
        for seed in (0, 1)
        for role in (Role.AGENT, Role.ENVIRONMENT, Role.EXPERIMENT)
    } == {
        (0, Role.EXPERIMENT): 8226343694796210948,
        (1, Role.EXPERIMENT): 637987770806161565,
        (0, Role.AGENT): 2440950710608614359,
        (0, Role.ENVIRONMENT): 4334430513956379144,
        (1, Role.AGENT): 2021340933837429789,
        (1, Role.ENVIRONMENT): 4215923173971654960,
    }


# Players lost and replaced


@pytest.mark.parametrize(
    ("verb", "under_way"),
    [
        ((Kind.RL_START,), True),
        ((Kind.RL_STEP,), True),
        ((Kind.RL_ENV_START,), True),
        ((Kind.RL_ENV_STEP,), True),
        ((Kind.RL_EPISODE, 2), False),
        ((Kind.RL_CLEANUP,), False),
        ((Kind.RL_INIT, None), False),
    ],
)
@pytest.mark.parametrize("terminal", [False, True, CUT_OFF])
@pytest.mark.parametrize("before", [Kind.RL_START, Kind.RL_CLEANUP])
def test_an_episode_is_under_way_until_it_ends(
    before: Kind, verb: tuple[Any, ...], terminal: int, under_way: bool
) -> None:
    engine = initialised()
    drive(engine, before)
    drive(engine, *verb, env_step=(1.0, terminal))
    expected = under_way and not (terminal and verb[0] in (Kind.RL_STEP, Kind.RL_ENV_STEP))
    assert engine.in_episode is expected
    engine.void("the agent left")
    assert engine.in_episode is False
    if expected:
        for again in (Kind.RL_STEP, Kind.RL_ENV_STEP, Kind.RL_AGENT_STEP, Kind.RL_AGENT_END):
            with pytest.raises(PeerLost, match="the agent left; start another"):
                engine.begin(again)
    else:
        assert drive(engine, Kind.RL_STEP)[0] == ["ENV_STEP", "AGENT_STEP"]
        assert engine.in_episode, "also after a cut-off"


def test_an_episode_of_half_steps_counts_like_any_other() -> None:
    engine = initialised()
    for done in range(1, 4):
        drive(engine, Kind.RL_ENV_START)
        drive(engine, Kind.RL_ENV_STEP, env_step=ENDS)
        assert engine.num_episodes == done
        drive(engine, Kind.RL_ENV_START)
        drive(engine, Kind.RL_ENV_STEP, env_step=(1.0, CUT_OFF))
        assert (engine.num_episodes, engine.num_steps) == (done, 2)


def test_an_end_that_the_agent_did_not_live_to_hear_is_not_counted() -> None:
    engine = asked_for_a_step()
    assert engine.resume(Kind.ENV_STEP, ENDS, "o").kind is Kind.AGENT_END
    engine.abort()
    assert engine.num_episodes == 0


def test_an_agent_that_is_lost_at_the_cut_off_leaves_no_episode_behind() -> None:
    engine = asked_for_a_step()
    assert engine.resume(Kind.ENV_STEP, (1.0, CUT_OFF), "o").kind is Kind.AGENT_STEP
    assert not engine.in_episode


@pytest.mark.parametrize(
    ("role", "verb", "expected"),
    [
        (Role.AGENT, Kind.RL_START, "ENV_START AGENT_SEED AGENT_INIT AGENT_START"),
        (Role.ENVIRONMENT, Kind.RL_START, "ENV_SEED ENV_INIT ENV_START AGENT_START"),
        (Role.AGENT, Kind.RL_AGENT_MESSAGE, "AGENT_SEED AGENT_INIT AGENT_MESSAGE"),
        (Role.ENVIRONMENT, Kind.RL_AGENT_MESSAGE, "AGENT_MESSAGE"),
        (Role.AGENT, Kind.RL_CLEANUP, "ENV_CLEANUP AGENT_SEED AGENT_INIT AGENT_CLEANUP"),
        (Role.AGENT, Kind.RL_NUM_STEPS, ""),
        (Role.AGENT, Kind.RL_INIT, "ENV_SEED ENV_INIT AGENT_SEED AGENT_INIT"),
    ],
)
def test_a_replaced_player_is_initialised_before_anything_else(role: Role, verb: Kind, expected: str) -> None:
    engine = initialised(seed=3)
    engine.replace(role)
    scalars = (3,) if verb is Kind.RL_INIT else ()
    assert drive(engine, verb, *scalars)[0] == expected.split()
    again, _ = drive(engine, Kind.RL_START)
    if verb is not Kind.RL_NUM_STEPS and not (role is Role.ENVIRONMENT and verb is Kind.RL_AGENT_MESSAGE):
        assert again == ["ENV_START", "AGENT_START"], "once is enough"


def test_both_players_replaced_are_initialised_each_in_turn() -> None:
    engine = initialised()
    engine.replace(Role.AGENT)
    engine.replace(Role.ENVIRONMENT)
    made, reply = drive(engine, Kind.RL_EPISODE, 3)
    assert made == ["ENV_INIT", "ENV_START", "AGENT_INIT", "AGENT_START", *("ENV_STEP", "AGENT_STEP") * 2]
    assert reply == Instruction(Kind.RL_EPISODE, (False,), None)


def test_a_replaced_environment_of_another_task_has_the_agent_initialised_again() -> None:
    engine = initialised()
    engine.replace(Role.ENVIRONMENT)
    engine.begin(Kind.RL_START)
    engine.resume(Kind.ENV_INIT, (), "another spec")
    step = engine.resume(Kind.ENV_START, (), "o")
    assert step == Instruction(Kind.AGENT_INIT, (), "another spec")
    made, _ = go_on(engine, step)
    assert made == ["AGENT_INIT", "AGENT_START"]


def test_a_player_that_takes_an_empty_seat_while_it_is_asked_is_initialised_first() -> None:
    engine = initialised(seed=3)
    step = engine.begin(Kind.RL_START)
    step = engine.resume(Kind.ENV_START, (), "o")
    assert step.kind is Kind.AGENT_START
    engine.replace(Role.AGENT)
    assert engine.awaiting is Kind.AGENT_SEED
    assert engine.asked is not None
    made, reply = go_on(engine, engine.asked)
    assert made == ["AGENT_SEED", "AGENT_INIT", "AGENT_START"]
    assert reply.body == ("o", "a0")


def test_a_player_that_comes_in_the_middle_of_init_is_initialised_once() -> None:
    engine = initialised()
    engine.begin(Kind.RL_INIT, (None,))
    step = engine.resume(Kind.ENV_INIT, (), "spec")
    assert step.kind is Kind.AGENT_INIT
    engine.replace(Role.AGENT)
    assert engine.asked == step
    engine.resume(Kind.AGENT_INIT, (), None)
    assert drive(engine, Kind.RL_START)[0] == ["ENV_START", "AGENT_START"]


def test_a_player_replaced_before_any_init_is_not_initialised() -> None:
    engine = Engine(b"")
    engine.replace(Role.AGENT)
    assert drive(engine, Kind.RL_START)[0] == ["ENV_START", "AGENT_START"]
