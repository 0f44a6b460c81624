"""The planner, on levels that it has not seen before."""

from __future__ import annotations

import json
import random
from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from agents.planner.agent import PlannerAgent
from env_server.mario.environment import InfiniteMario
from env_server.mario.game import Game
from env_server.mario.level_sets import LEVEL_SETS
from tests.agents.screens import TASK_SPEC

TASK = InfiniteMario().parameters


def play(agent: PlannerAgent, level: int, steps: int = 1000) -> Iterator[tuple[list[int], float]]:
    """Yield the actions and rewards of an episode on a training level."""
    return play_on(Game(LEVEL_SETS["train-200"].level(TASK, level)), agent, steps)


def play_on(game: Game, agent: PlannerAgent, steps: int = 1000) -> Iterator[tuple[list[int], float]]:
    """Yield the actions and rewards of the next episode of a game."""
    action = agent.agent_start(game.start())
    for _ in range(steps):
        buttons = action.ints.tolist()
        reward, observation, ended, *_ = game.step(*buttons)
        yield buttons, reward
        if ended:
            agent.agent_end(reward)
            break
        action = agent.agent_step(reward, observation)


def made(**options: object) -> PlannerAgent:
    agent = PlannerAgent(**options)  # type: ignore[arg-type]
    agent.agent_init(TASK_SPEC)
    return agent


@pytest.mark.parametrize("level", [0, 1, 2, 9, 102])
def test_goal_is_reached_at_first_sight(level: int) -> None:
    assert [*play(made(), level)][-1][1] == 100


def test_more_time_for_each_step_is_more_model_steps(monkeypatch: pytest.MonkeyPatch) -> None:
    """On a clock on which a model step takes as long as the agent assumes at first."""

    def sims(step_seconds: float) -> int:
        agent = made(step_seconds=step_seconds)
        clock = SimpleNamespace(perf_counter=lambda: 2e-6 * agent._used)
        monkeypatch.setattr("agents.planner.agent.time", clock)
        assert [*play(agent, 3, 10)]
        return agent._used

    assert sims(0.0001) < sims(0.005) / 10


def test_replaced_actions_are_recognised() -> None:
    agent, chance = made(), random.Random(1)
    for level in range(6):
        game = Game(LEVEL_SETS["train-200"].level(TASK, level))
        action, ended = agent.agent_start(game.start()), False
        while not ended:
            buttons = action.ints.tolist()
            if chance.random() < 0.2:
                buttons = [chance.randint(-1, 1), chance.randint(0, 1), chance.randint(0, 1)]
            reward, observation, ended, *_ = game.step(*buttons)
            action = agent.agent_step(reward, observation)
    found = json.loads(agent.agent_message("predictions"))
    assert found["exact"] > 0.85 * found["steps"]


def test_bonus_earns_more_than_the_goal_alone() -> None:
    assert sum(reward for _, reward in play(made(bonus=15.0), 4)) > sum(
        reward for _, reward in play(made(), 4)
    )


def test_shares_of_exact_predictions_fall_with_the_horizon() -> None:
    agent = made(horizons=True)
    assert [*play(agent, 0)]
    found = json.loads(agent.agent_message("predictions"))
    shares = [found["horizons"][ahead] for ahead in ("1", "3", "5", "10")]
    assert 0 < found["exact"] <= found["steps"] < found["sims"]
    assert shares == sorted(shares, reverse=True)
    assert shares[0] > 0.8


def test_plan_begins_where_mario_will_be() -> None:
    agent, game = made(), Game(LEVEL_SETS["train-200"].level(TASK, 0))
    action = agent.agent_start(game.start())
    for _ in range(10):
        marks = json.loads(agent.agent_message("marks"))
        reward, observation, *_ = game.step(*action.ints.tolist())
        assert marks[0] == pytest.approx([observation.doubles[0], observation.doubles[1] + 0.5], abs=0.001)
        assert len(marks) > 1
        action = agent.agent_step(reward, observation)


def test_known_level_is_planned_as_a_whole() -> None:
    """A route is never worse than the best episode before it, and is saved with the level."""
    agent, other = made(bonus=15.0, study=6_000), made(bonus=15.0, study=6_000)
    totals = [sum(reward for _, reward in play(agent, 3)) for _ in range(2)]
    other.agent_load(agent.agent_save())
    assert [*play(agent, 3)] == [*play(other, 3)]
    totals.append(sum(reward for _, reward in play(agent, 3)))
    assert totals[-1] >= totals[0] > 100


def test_routes_of_level_121_earn_at_least_155_from_the_fifth_episode_on() -> None:
    """Each episode begins with the buttons that the previous one left pressed."""
    agent, game = made(bonus=15.0, sims=400, study=1_500_000), Game(TASK)
    totals = [sum(reward for _, reward in play_on(game, agent)) for _ in range(8)]
    assert min(totals[4:]) >= 155
