"""The planner that is not given the physical constants and the rewards of the game."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from agents.planner.agent import PlannerAgent
from agents.planner.learner import LearningPlannerAgent
from env_server.mario import model
from env_server.mario.environment import check_parameters
from env_server.mario.game import Game
from env_server.mario.level_sets import LEVEL_SETS
from glue.errors import ConfigError, SaveError
from tests.agents.planner.test_planner import play_on
from tests.agents.screens import TASK_SPEC

FIVE = [name != "speed_slidejump" for name in model.CONSTANTS]
REAL = {
    "speed_walk": 0.4347,
    "speed_run": 1.5131,
    "speed_jump": -2.2173,
    "accel_fall": 0.7771,
    "jump_time": 9,
}


def made() -> LearningPlannerAgent:
    agent = LearningPlannerAgent()
    agent.agent_init(TASK_SPEC)
    return agent


def played(agent: PlannerAgent, options: dict[str, Any], level: int, steps: int = 10_000) -> list[float]:
    """Return the rewards of an episode on a training level."""
    game = Game(LEVEL_SETS["train-200"].level(check_parameters(options), level))
    return [reward for _, reward in play_on(game, agent, steps)]


@pytest.mark.parametrize("level", [0, 1, 2])
@pytest.mark.parametrize(
    "options", [{"instance": 0}, {"instance": 7}, {"mdp": "proving-6"}, {"mdp": "proving-8"}, REAL], ids=str
)
def test_constants_are_identified_within_ten_steps(options: dict[str, Any], level: int) -> None:
    task = check_parameters(options)
    agent = made()
    played(agent, options, level, 10)
    truth = np.array([getattr(task, name) for name in model.CONSTANTS], float)
    assert np.abs(agent.physics.constants - truth)[FIVE].max() < 0.001
    assert agent.physics.known[FIVE].all()


def test_published_constants_are_found_to_the_last_bit_and_the_goal_is_reached() -> None:
    agent = made()
    assert played(agent, {"instance": 7}, 1)[-1] == 100
    assert agent.physics.constants[:4].tolist() == [1.2, 2.4, -3.9, 0.92]
    agent.agent_init(TASK_SPEC)
    assert agent.physics.constants.tolist() == model.constants().tolist()
    assert not agent.physics.known.any()


def test_rewards_are_learned() -> None:
    agent = made()
    played(agent, {"reward_coin": 0.0, "reward_kill": 2.0, "reward_goal": 10.0}, 4)
    found = json.loads(agent.agent_message("physics"))["rewards"]
    assert found["goal"] == 10
    assert "death" not in found
    assert found["step"] == pytest.approx(-0.01, abs=0.001)
    assert found["coin"] == pytest.approx(0, abs=0.01)


def test_what_was_learned_is_saved() -> None:
    agent, other = made(), made()
    played(agent, {"instance": 7}, 1)
    other.agent_load(agent.agent_save())
    assert other.agent_message("physics") == agent.agent_message("physics")
    assert played(other, {"instance": 7}, 1) == played(agent, {"instance": 7}, 1)
    plain = PlannerAgent()
    plain.agent_init(TASK_SPEC)
    with pytest.raises(SaveError):
        plain.agent_load(agent.agent_save())


def test_planner_that_is_told_the_constants_predicts_with_them() -> None:
    told = PlannerAgent(constants="speed_walk=1.2 speed_run=2.4 speed_jump=-3.9 accel_fall=0.92")
    told.agent_init(TASK_SPEC)
    assert played(told, {"instance": 7}, 1)[-1] == 100
    for wrong in ("speed_rum=1", "speed_run=fast", "speed_run=nan", "speed_run=1e9"):
        with pytest.raises(ConfigError):
            PlannerAgent(constants=wrong)
