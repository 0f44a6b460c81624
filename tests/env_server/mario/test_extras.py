"""Mario's extras, against what rewards and observations say of the same."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from agents.mario.runner import RunRightAgent
from env_server.mario.environment import InfiniteMario
from env_server.mario.many.environment import InfiniteMarioBatch
from glue import Action, ConfigError, Observation, SimulatorError, local
from glue.roles import capabilities

MODES = {0: "small", 10: "large", 11: "fire"}


class Seeing(RunRightAgent):
    """Records its first observations."""

    def __init__(self) -> None:
        super().__init__()
        self.seen: list[Observation] = []

    def agent_start(self, observation: Observation) -> Action:
        self.seen.append(observation)
        return super().agent_start(observation)


def told(observation: Observation) -> dict[str, Any]:
    return dict(observation.extras)


def playing(**options: Any) -> InfiniteMario:
    mario = InfiniteMario(extras=True, **options)
    mario.env_init()
    return mario


def test_extras_agree_with_rewards_and_observations() -> None:
    random, modes, deaths = np.random.default_rng(5), set(), set()
    rewards = {"reward_step": 0.0, "reward_coin": 1.0, "reward_kill": 1000.0, "reward_goal": 0.0}
    for level in range(12):
        mario = playing(level_seed=level, level_difficulty=3, **rewards)
        seen = mario.env_start()
        mario.game.world.large, mario.game.world.fire = level % 3 > 0, level % 3 > 1
        total, ended = float(told(seen)["coins"]), False  # the first observation's reward is not paid out
        while not ended:
            last = seen
            moves = [1, int(random.random() < 0.6), int(random.random() < 0.7)]
            reward, seen, ended, *_ = mario.env_step(Action(moves))
            total += reward
            if not ended:
                assert total == told(seen)["coins"] + 1000 * told(seen)["kills"]
                assert told(seen)["distance"] == pytest.approx(seen.doubles[0], abs=1e-6)
                assert told(seen)["mode"] == MODES[int(seen.ints[1])]
                assert told(last)["death"] == "", "he has died before the last step but one"
                modes.add(told(seen)["mode"])
        assert seen.without() == last.without()
        assert told(last)["death"] in ("", told(seen)["death"])
        deaths.add(told(seen)["death"])
    assert deaths >= {"enemy", "fall"}
    assert modes == {*MODES.values()}


def test_the_step_limit_and_the_goal_are_told_apart() -> None:
    mario = playing(max_trial_steps=4)
    mario.env_start()
    found = [mario.env_step(Action([0, 0, 0])) for _ in range(4)]
    assert [told(step.observation)["death"] for step in found] == ["", "", "", "time"]
    mario = playing(level_width=0)
    mario.env_start()
    ended = False
    while not ended:
        reward, seen, ended, *_ = mario.env_step(Action([1, 1, 1]))
    assert (reward, told(seen)["death"]) == (100.0, "")


def test_without_the_option_there_are_none_and_agents_never_see_any() -> None:
    assert capabilities(InfiniteMario()) == ("save", "truncate")
    assert capabilities(InfiniteMario(extras=True)) == ("extras", "save", "truncate")
    plain, agent = InfiniteMario(level_seed=3), Seeing()
    plain.env_init()
    with local(agent, InfiniteMario(level_seed=3, extras=True)) as glue:
        glue.rl_init()
        seen = glue.rl_start().observation
    assert [*told(seen)] == ["coins", "kills", "distance", "death", "mode"]
    assert [seen.without()] == agent.seen == [plain.env_start()]


def test_many_games_at_once_have_no_extras() -> None:
    with pytest.raises(ConfigError, match="extras"):
        InfiniteMarioBatch(InfiniteMario(extras=True), 2)
    gymnasium = pytest.importorskip("gymnasium")
    with pytest.raises(SimulatorError, match="extras"):
        gymnasium.make("env_server.gym:glue/InfiniteMario-v0", extras=True)
