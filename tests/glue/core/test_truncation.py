"""An environment that cuts its episodes off, in one process and over the hub."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager

import pytest

from glue import CUT_OFF, Action, Agent, Environment, Observation, local
from glue.core.engine import Engine
from glue.core.experiment import Experiment
from glue.protocol.messages import Kind
from glue.protocol.steps import step_formats
from glue.roles import capabilities
from tests.hubs import over_the_hub
from tests.players import ScriptedAgent, ScriptedEnvironment

Glue = Callable[[Agent, Environment], AbstractContextManager[Experiment]]
BOTH = pytest.mark.parametrize("glue", [local, over_the_hub])


class CuttingEnvironment(ScriptedEnvironment):
    """Cuts every second of its episodes off."""

    episodes = 0

    def env_start(self) -> Observation:
        self.episodes += 1
        return super().env_start()

    def env_truncated(self) -> bool:
        return self.episodes % 2 == 0


LAST_STEPS = ["agent_start [0]", "agent_step 1 [1]", "agent_step 1 [2]"]


@BOTH
def test_the_agent_gets_the_last_observation_and_no_end(glue: Glue) -> None:
    agent = ScriptedAgent()
    with glue(agent, CuttingEnvironment()) as experiment:
        experiment.rl_init()
        assert experiment.rl_episode() is True
        assert (experiment.rl_num_steps(), experiment.rl_num_episodes()) == (3, 1)
        agent.calls.clear()
        assert experiment.rl_episode() is False
        assert agent.calls == [*LAST_STEPS, "agent_step 1 [3]"]
        assert (experiment.rl_num_steps(), experiment.rl_num_episodes()) == (4, 1)
        assert experiment.rl_return() == 3.0


@BOTH
def test_single_steps_say_that_the_episode_was_cut_off(glue: Glue) -> None:
    agent = ScriptedAgent()
    with glue(agent, CuttingEnvironment()) as experiment:
        experiment.rl_init()
        for expected in (True, CUT_OFF):
            experiment.rl_start()
            terminals = [experiment.rl_step().terminal for _ in range(2)]
            last = experiment.rl_step()
            assert [*terminals, last.terminal] == [False, False, expected]
        assert last.observation == Observation([3])
        assert last.action == Action([103]), "the agent's answer to the last observation"
        experiment.rl_env_start()
        experiment.rl_env_start()
        steps = [experiment.rl_env_step(Action([0])) for _ in range(3)]
        assert [terminal for _, _, terminal in steps] == [False, False, CUT_OFF]
        assert experiment.rl_num_episodes() == 1


def test_the_capability_is_that_of_the_method() -> None:
    assert capabilities(CuttingEnvironment()) == ("truncate",)
    assert capabilities(ScriptedEnvironment()) == ()


def test_to_an_environment_without_the_capability_two_is_true() -> None:
    class Older(ScriptedEnvironment):
        def env_step(self, action: Action) -> tuple[float, Observation, bool]:
            reward, observation, terminal = super().env_step(action)
            return reward, observation, 2 * terminal  # type: ignore[return-value]

    agent = ScriptedAgent()
    with over_the_hub(agent, Older()) as experiment:
        experiment.rl_init()
        assert experiment.rl_episode() is True
    assert agent.calls[-1] == "agent_end 1"


def test_quick_form_of_a_step_is_that_of_the_decoder() -> None:
    _, reply = step_formats(Kind.ENV_STEP, "walk")
    data = reply.encode(7, (1.0, CUT_OFF), Observation([11]).body)
    decoded = reply.decode(data)
    assert decoded is not None
    assert (1.0, CUT_OFF) in decoded[0]
    assert bytes.fromhex("950d a477616c6b 07 cb3ff0000000000000 02") in data


def test_an_agent_that_is_lost_at_the_cut_off_leaves_no_episode_behind() -> None:
    engine = Engine(b"")
    engine.begin(Kind.RL_ENV_START)
    engine.resume(Kind.ENV_START, (), b"")
    engine.begin(Kind.RL_STEP)
    call = engine.resume(Kind.ENV_STEP, (1.0, CUT_OFF), b"saw")
    assert call == (Kind.AGENT_STEP, (1.0,), b"saw")
    assert not engine.in_episode
    reply = engine.resume(Kind.AGENT_STEP, (), b"did")
    assert reply == (Kind.RL_STEP, (1.0, CUT_OFF), (b"saw", b"did"))
