"""Rules that recordings of the original rarely or never reach: small scenes, with numbers computed by hand.

The scenes are those of conftest.py: empty except for what a test puts there.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from env_server.mario.game import Game, terminal_reward
from env_server.mario.parameters import resolve
from env_server.mario.sim.blocks import hit_block
from env_server.mario.sim.state import (
    ACTORS,
    FIREBALL,
    FLOWER,
    FREE,
    GOOMBA,
    MARIO,
    MUSHROOM,
    PLANT,
    SHELL,
    Actor,
    LevelMap,
    World,
)
from env_server.mario.sim.step import tick
from env_server.mario.sim.tiles import (
    BRICK,
    COIN,
    EMPTY,
    QUESTION_WITH_COIN,
    QUESTION_WITH_POWER_UP,
    USED_BLOCK,
    set_tile,
    tile_at,
    write_cells,
)

_HEIGHTS = {FIREBALL: 8}


def move(actor: Actor, x: float, y: float) -> None:
    actor.x, actor.y = np.float32(x), np.float32(y)


def put(world: World, kind: int, x: float, y: float, **fields: Any) -> Actor:
    """Put an actor at the end of the list."""
    slot = world.listed + 1
    actor = world.actors[slot]
    start = {"height": _HEIGHTS.get(kind, 12), "facing": 1}
    zero = ("vx", "vy", "grounded", "winged", "flung", "dead", "carried", "dead_timer", "age", "queued")
    for name, value in (dict.fromkeys((*zero, "leaving"), 0) | start | fields).items():
        setattr(actor, name, value)
    actor.kind = kind
    actor.column = actor.row = -1
    move(actor, x, y)
    world.order[world.listed] = slot
    world.listed += 1
    return actor


def state(actor: Actor, *names: str) -> tuple[float, ...]:
    return tuple(float(getattr(actor, name)) for name in names)


def give_size(world: World, large: bool, fire: bool) -> None:
    world.large, world.fire = large, fire
    world.actors[0].height = 24 if large else 12


@pytest.mark.parametrize(
    ("block", "can_break", "left", "coins"),
    [(QUESTION_WITH_COIN, False, USED_BLOCK, 2), (BRICK, False, BRICK, 1), (BRICK, True, EMPTY, 1)],
)
def test_loose_coin_on_a_block_that_is_hit_is_taken(
    world: World, level: LevelMap, block: int, can_break: bool, left: int, coins: int
) -> None:
    set_tile(level, 5, 9, block)
    set_tile(level, 5, 8, COIN)
    hit_block(world, level, 5, 9, can_break)
    assert (tile_at(world, level, 5, 9), tile_at(world, level, 5, 8), world.coins) == (left, EMPTY, coins)


@pytest.mark.parametrize(
    ("kind", "fields", "after"),
    [
        (GOOMBA, {}, {"vx": -2, "vy": -5, "flung": 1, "dead_timer": 100, "facing": 1}),
        (GOOMBA, {"winged": 1}, {"vx": -2, "vy": -5, "winged": 0, "dead_timer": 100}),
        (GOOMBA, {"dead_timer": 7}, {"vx": 0, "vy": 0, "flung": 0, "dead_timer": 7}),
        (PLANT, {}, {"vx": -2, "vy": -5, "flung": 1, "dead_timer": 100}),
        (MUSHROOM, {"age": 4}, {"facing": -1, "vx": 0, "vy": -10, "age": 4}),
        (SHELL, {"facing": 0}, {"facing": -1, "vx": 0, "vy": -10}),
        (SHELL, {"carried": 1}, {"facing": -1, "vy": -10, "carried": 1}),
        (SHELL, {"dead_timer": 7}, {"facing": -1, "vy": -10, "dead_timer": 7}),
        (FIREBALL, {}, {"facing": 1, "vx": 0, "vy": 0, "dead_timer": 0}),
        (FLOWER, {}, {"facing": 1, "vx": 0, "vy": 0}),
    ],
)
def test_jolt_of_a_block_moves_who_stands_on_it(
    world: World, level: LevelMap, kind: int, fields: dict[str, Any], after: dict[str, float]
) -> None:
    set_tile(level, 5, 9, BRICK)  # x from 80 to 96, its upper side at y = 144
    actor = put(world, kind, 88, 143, **fields)
    hit_block(world, level, 5, 9, False)
    assert {name: getattr(actor, name) for name in after} == after
    assert world.kills == 0


@pytest.mark.parametrize(
    ("x", "y", "stands"),
    [
        (76, 143, False),
        (76.5, 143, True),
        (99.5, 143, True),
        (100, 143, False),
        (88, 144.5, True),  # the pixel above counts: from 129 up to, but not including, 145
        (88, 145, False),
        (88, 129, True),
        (88, 128.5, False),
    ],
)
def test_jolt_reaches_whose_feet_are_in_the_cell_above(
    world: World, level: LevelMap, x: float, y: float, stands: bool
) -> None:
    set_tile(level, 5, 9, BRICK)
    shell = put(world, SHELL, x, y)
    hit_block(world, level, 5, 9, False)
    assert (shell.vy == -10) == stands


def test_block_beyond_the_border_gives_but_stays(world: World, level: LevelMap) -> None:
    last = level.columns - 1
    set_tile(level, last, 9, QUESTION_WITH_COIN)  # continues to the right forever
    hit_block(world, level, int(last) + 1, 9, False)
    assert world.coins == 1
    assert level.tiles[last : last + 2, 9].tolist() == [QUESTION_WITH_COIN, EMPTY]


def test_item_for_which_there_is_no_place_is_left_out(world: World, level: LevelMap) -> None:
    for _ in range(ACTORS - 1):
        put(world, FLOWER, 300, 100)
    set_tile(level, 5, 9, QUESTION_WITH_POWER_UP)
    hit_block(world, level, 5, 9, False)
    assert (tile_at(world, level, 5, 9), world.listed, world.added) == (USED_BLOCK, ACTORS - 1, 0)


def test_tile_that_stops_only_rising_is_hit_from_below(world: World, level: LevelMap) -> None:
    mario = world.actors[0]
    set_tile(level, 6, 5, 1)  # y from 80 to 96; it holds a coin
    move(mario, 104, 109)  # small: his head is at 97
    mario.vy = np.float32(-4)
    tick(world, level)
    assert mario.y == 108  # 16 * trunc(97 / 16) + 12
    assert mario.vy == 3  # set to 0, then gravity
    assert (world.coins, tile_at(world, level, 6, 5)) == (1, USED_BLOCK)


def test_tile_that_stops_only_rising_lets_him_fall_through(world: World, level: LevelMap) -> None:
    mario = world.actors[0]
    set_tile(level, 6, 7, 1)  # its top is at y = 112
    move(mario, 104, 111)
    mario.vy = np.float32(4)
    tick(world, level)
    assert mario.y == 115


@pytest.mark.parametrize(
    ("item", "large", "fire", "coins"),
    [
        (MUSHROOM, False, False, 0),
        (MUSHROOM, True, False, 1),
        (MUSHROOM, True, True, 1),
        (FLOWER, False, False, 0),
        (FLOWER, True, False, 0),
        (FLOWER, True, True, 1),
    ],
)
def test_item_that_gives_nothing_new_is_a_coin(
    world: World, level: LevelMap, item: int, large: bool, fire: bool, coins: int
) -> None:
    give_size(world, large, fire)
    taken = put(world, item, 100, 100, age=9)
    tick(world, level)
    assert taken.kind == FREE
    assert world.coins == coins
    assert (bool(world.large), bool(world.fire)) == (True, fire or item == FLOWER)
    assert world.frozen == (coins == 0)
    assert world.change_timer == (0 if coins else 18)


def test_second_item_of_a_tick_is_lost(world: World, level: LevelMap) -> None:
    put(world, FLOWER, 100, 100, age=9)
    second = put(world, MUSHROOM, 98.25, 100, age=9)  # would be a coin, but the game stands still
    tick(world, level)
    assert second.kind == FREE
    assert world.coins == 0
    assert world.fire


def test_enemy_stomped_while_the_game_stands_still_dies_for_nothing(world: World, level: LevelMap) -> None:
    mario = world.actors[0]
    mario.vy = np.float32(4)
    put(world, FLOWER, 100, 104, age=9)
    goomba = put(world, GOOMBA, 98.25, 110)
    tick(world, level)
    assert mario.y == 104
    assert goomba.x == 100
    assert world.frozen
    assert goomba.dead_timer == 10
    assert world.kills == 0
    assert mario.vy == np.float32(np.float32(4 * 0.82) + np.float32(3))  # no bounce


def test_wings_stomped_off_are_no_kill(world: World, level: LevelMap) -> None:
    mario = world.actors[0]
    mario.vy = np.float32(4)
    goomba = put(world, GOOMBA, 98.25, 110, winged=1)
    tick(world, level)
    assert state(goomba, "winged", "vy", "dead_timer") == (0, 0, 0)
    assert world.kills == 0
    assert mario.y == 104  # at 110 - 6
    assert mario.vy == np.float32(8) * np.float32(-1.9)
    assert (world.jump_count, world.safe_timer) == (8, 1)


def test_carried_shell_and_the_shell_it_meets_both_die(world: World, level: LevelMap) -> None:
    world.button_run = True
    carried = put(world, SHELL, 108, 98, carried=1)
    world.carrying = 1
    other = put(world, SHELL, 117, 100, facing=0)  # 17 from Mario, out of his reach
    tick(world, level)
    assert world.carrying == 0
    for shell, vx in ((carried, -2), (other, 0)):
        assert state(shell, "dead", "carried", "dead_timer") == (1, 0, 100)
        assert state(shell, "vx", "vy") == (vx, -5)
    assert state(carried, "x", "y") == (108, 98)
    assert world.kills == 0


def test_second_shell_that_he_takes_leaves_the_first_where_it_is(world: World, level: LevelMap) -> None:
    world.button_run = True
    first = put(world, SHELL, 108, 98, carried=1)
    world.carrying = 1
    second = put(world, SHELL, 88, 100, facing=0)
    tick(world, level)
    assert world.carrying == 2
    world.button_run, world.button_left = False, True
    world.speed_walk = 1.0
    tick(world, level)  # he falls by 3, turns left and lets go
    assert world.carrying == 0
    assert state(first, "carried", "x", "y") == (1, 108, 98)
    assert state(second, "carried", "facing", "x", "y") == (0, -1, 99 - 8 - 8, 101)


def test_shell_carried_off_the_screen_is_gone(world: World, level: LevelMap) -> None:
    world.button_run = True
    move(world.actors[0], 100, -70)
    shell = put(world, SHELL, 108, -72, carried=1)
    world.carrying = 1
    tick(world, level)
    assert (shell.kind, world.carrying, world.listed) == (FREE, 0, 0)


def test_nobody_passes_the_right_border(world: World, level: LevelMap) -> None:
    mario = world.actors[0]
    move(mario, 799, 100)  # the level has 50 columns
    mario.vx = np.float32(5)
    tick(world, level)
    assert state(mario, "x", "vx") == (800, 0)
    assert world.camera == 800 - 320
    assert not world.frozen


@pytest.mark.parametrize(("x", "wins"), [(160, False), (160.5, True)])
def test_goal_has_to_be_passed(world: World, level: LevelMap, x: float, wins: bool) -> None:
    level.exit_x = 10
    move(world.actors[0], x, 100)
    tick(world, level)
    assert (world.win_timer, bool(world.frozen)) == (int(wins), wins)


@pytest.mark.parametrize(("y", "dies"), [(256, False), (256.5, True)])
def test_fall_has_to_pass_a_tile_below_the_level(world: World, level: LevelMap, y: float, dies: bool) -> None:
    move(world.actors[0], 100, y)
    tick(world, level)
    assert (world.death_timer, bool(world.frozen)) == (int(dies), dies)


def test_winning_takes_precedence_over_dying(world: World) -> None:
    world.win_timer = world.death_timer = 1
    assert terminal_reward(world) == 100


def test_dead_mario_pauses_leaps_and_falls(world: World, level: LevelMap) -> None:
    mario = world.actors[0]
    mario.vx = np.float32(3)
    world.frozen, world.death_timer = True, 1
    ys = []
    for _ in range(12):
        tick(world, level)
        ys.append(float(mario.y))
    assert ys == [100] * 9 + [85, 72, 61]  # by -15, -13, -11
    assert mario.x == 100


@pytest.mark.parametrize(
    ("column", "facing"),
    [(2, 1), (5, 1), (6, 1), (7, 1), (8, -1)],  # he is left of it only if its middle is past 104 + 16
)
def test_enemy_comes_in_facing_mario(world: World, level: LevelMap, column: int, facing: int) -> None:
    move(world.actors[0], 104, 200)
    world.scanned_to = -1
    level.spawns[column, 3] = GOOMBA
    write_cells(level, column)
    tick(world, level)
    goomba = world.actors[int(world.order[0])]
    assert state(goomba, "kind", "facing") == (GOOMBA, facing)
    assert state(goomba, "x", "y", "vy") == (16 * column + 8 + 1.75 * facing, 63, 2)


def test_win_is_told_a_step_later_where_only_check_ins_are_drawn() -> None:
    game = Game(resolve({"render": "checkin"}))
    game.start()
    mario = game.world.actors[0]
    assert mario.kind == MARIO
    move(mario, 16 * game.level_map.exit_x + 1, 100)
    reward, observation, ended, *_ = game.step(1, 0, 0)
    assert reward == pytest.approx(-0.01)
    assert not ended
    assert observation.doubles[0] == game.level_map.exit_x + 1 / 16
    # He has stood still since tick 1.
    assert observation.doubles[2:4].tobytes() == np.array([0.0, -0.0]).tobytes()
    assert game.step(1, 0, 0) == (100.0, observation, True)
