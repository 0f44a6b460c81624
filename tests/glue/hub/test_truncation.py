"""An environment that cuts its episodes off, in one process and over the hub."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

import pytest

from glue import CUT_OFF, Action, Agent, Environment, Observation, Step, local
from glue.engine.engine import Engine
from glue.engine.experiment import Experiment
from glue.wire.messages import Kind
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

    def env_step(self, action: Action) -> Any:
        reward, observation, terminal = super().env_step(action)
        return Step(reward, observation, terminal, terminal and self.episodes % 2 == 0)


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
        for truncated in (False, True):
            experiment.rl_start()
            terminals = [experiment.rl_step().terminal for _ in range(2)]
            last = experiment.rl_step()
            assert [*terminals, last.terminal, last.truncated] == [False, False, True, truncated]
        assert last.observation == Observation([3])
        assert last.action == Action([103]), "the agent's answer to the last observation"
        experiment.rl_env_start()
        experiment.rl_env_start()
        steps = [experiment.rl_env_step(Action([0])) for _ in range(3)]
        assert [(step.terminal, step.truncated) for step in steps] == [(False, False)] * 2 + [(True, True)]
        assert experiment.rl_num_episodes() == 1


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
