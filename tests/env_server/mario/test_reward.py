"""Rewards, computed by hand; `test_sim_golden` compares them to the last bit."""

from __future__ import annotations

import pytest

from env_server.mario.game import Game
from env_server.mario.parameters import resolve
from env_server.mario.reward import ordinary_reward, terminal_reward
from env_server.mario.sim.state import World


@pytest.fixture
def world() -> World:
    game = Game(
        resolve(
            {
                "reward_goal": 50.0,
                "reward_death": -7.0,
                "reward_step": -0.25,
                "reward_coin": 2.0,
                "reward_kill": 3.0,
            }
        )
    )
    game.start()
    return game.world


def test_first_check_in_counts_as_paid(world: World) -> None:
    assert world.paid == 0.25
    world.steps = 1
    assert ordinary_reward(world) == -0.25


def test_coins_and_kills_are_paid_once(world: World) -> None:
    world.steps, world.coins, world.kills = 1, 2, 3
    assert ordinary_reward(world) == -0.25 + 2 * 2 + 3 * 3
    world.steps = 2
    assert ordinary_reward(world) == -0.25


def test_reward_is_the_difference_of_totals_not_the_increment() -> None:
    game = Game(resolve({}))
    game.start()
    rewards = {game.step(0, 0, 0)[0] for _ in range(10)}
    assert -0.01 in rewards
    assert -0.010000000000000002 in rewards


def test_terminal_reward_stands_alone(world: World) -> None:
    world.coins = 5
    world.death_timer = 1
    assert terminal_reward(world) == -7
    world.win_timer = 1
    assert terminal_reward(world) == 50
