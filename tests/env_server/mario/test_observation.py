"""The part of the world that an observation shows."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from env_server.mario.game import Game
from env_server.mario.observation import BODY_SIZE, encode
from env_server.mario.parameters import resolve
from env_server.mario.sim import state
from env_server.mario.sim.state import Actor, LevelMap, World
from env_server.mario.sim.tiles import COIN, EMPTY, set_tile
from glue.types import Observation


@pytest.fixture
def game() -> Game:
    game = Game(resolve({"level_width": 0}))
    game.start()
    return game


@pytest.fixture
def level(game: Game) -> LevelMap:
    """An empty level with a floor in its lowest row."""
    level = game.level_map
    level.tiles[:] = EMPTY
    for column in range(level.columns):
        set_tile(level, column, 14, 129)
    return level


@pytest.fixture
def world(game: Game) -> World:
    """Mario in mid-air at tile (3, 6)."""
    world = game.world
    world.listed = 0
    place(world.actors[0], 16 * 3 + 8, 16 * 6 + 8)
    return world


def place(actor: Actor, x: float, y: float, dx: float = 0, dy: float = 0) -> None:
    """Put an actor at (x, y) pixels, to which the last tick moved it by (dx, dy)."""
    actor.x, actor.y = np.float32(x), np.float32(y)
    actor.old_x, actor.old_y = np.float32(x - dx), np.float32(y - dy)


def seen(world: World, level: LevelMap) -> Observation:
    body: npt.NDArray[np.uint8] = np.zeros(BODY_SIZE, np.uint8)
    size = encode(world, level, body)
    return Observation.from_body(body[:size].tobytes())


def rows(world: World, level: LevelMap) -> list[str]:
    return seen(world, level).chars.decode().split("\n")


def test_screen_is_sixteen_rows_of_21_with_the_lowest_repeated(world: World, level: LevelMap) -> None:
    level.exit_x = 49
    screen = rows(world, level)
    assert screen[14] == screen[15] == "7" * 21
    assert screen[6] == "   M".ljust(21)
    assert screen[16] == ""
    assert all(row == " " * 21 for i, row in enumerate(screen[:14]) if i != 6)


@pytest.mark.parametrize(
    ("code", "char"),
    [
        *[(EMPTY, " "), (COIN, "$"), (16, "b"), (17, "b"), (18, "7"), (21, "?"), (22, "?"), (4, "7")],
        *[(9, "7"), (10, "|"), (11, "|"), (26, "|"), (27, "|"), (133, "1"), (149, " "), (180, "1")],
        *[(1, "2"), (129, "7"), (145, " "), (141, "7")],
    ],
)
def test_tile_is_shown_by_what_it_does(world: World, level: LevelMap, code: int, char: str) -> None:
    set_tile(level, 10, 4, code)
    assert rows(world, level)[4][10] == char


def test_goal_column_hides_tiles_but_not_mario(world: World, level: LevelMap) -> None:
    level.exit_x = 3
    column = [row[3] for row in rows(world, level)[:16]]
    assert column == ["!"] * 6 + ["M"] + ["!"] * 9


@pytest.mark.parametrize(
    ("y", "row"),
    [(16 * 6 + 0.5, 6), (16 * 6, 5), (15.5, 0), (0, None), (-3, None), (250, 15), (271, 15), (272, None)],
)
def test_mario_is_shown_in_the_row_of_his_feet(
    world: World, level: LevelMap, y: float, row: int | None
) -> None:
    place(world.actors[0], 56, y)
    shown = [i for i, line in enumerate(rows(world, level)[:16]) if "M" in line]
    assert shown == ([] if row is None else [row])


def test_columns_start_at_the_drawn_camera_and_the_last_one_goes_on(world: World, level: LevelMap) -> None:
    set_tile(level, 49, 2, COIN)
    world.drawn_camera = 16 * 30 + 15
    level.exit_x = 0
    assert seen(world, level).ints[0] == 30
    assert rows(world, level)[2] == " " * 19 + "$$"
    assert not any("M" in row for row in rows(world, level))


@pytest.mark.parametrize(("large", "fire", "kind"), [(False, False, 0), (True, False, 10), (True, True, 11)])
def test_kind_of_mario_tells_his_size(
    world: World, level: LevelMap, large: bool, fire: bool, kind: int
) -> None:
    world.large, world.fire = large, fire
    assert seen(world, level).ints.tolist() == [0, kind, 0]


def test_actors_follow_in_the_order_of_the_list(world: World, level: LevelMap) -> None:
    for slot, (kind, winged) in enumerate([(state.SHELL, False), (state.SPIKY, True)], start=1):
        world.actors[slot].kind = kind
        world.actors[slot].winged = winged
        place(world.actors[slot], 16 * slot, 32 * slot)
    world.order[:2] = 2, 1
    world.listed = 2
    observation = seen(world, level)
    assert observation.ints.tolist() == [0, 0, 0, state.SPIKY, 1, state.SHELL, 0]
    assert observation.doubles.reshape(3, 4)[1:, :2].tolist() == [[2, 12], [1, 14]]


def test_velocity_is_the_last_tick_scaled_to_a_step(world: World, level: LevelMap) -> None:
    place(world.actors[0], 64, 64, dx=4, dy=-2)
    assert seen(world, level).doubles.tolist() == [4, 12, 5 * 4 / 16, 5 * 2 / 16]


def test_velocity_of_the_first_binary_is_a_fifth_of_a_tick_in_pixels(world: World, level: LevelMap) -> None:
    world.velocity_of_jar = True
    place(world.actors[0], 64, 64, dx=4, dy=-2)
    assert seen(world, level).doubles.tolist() == [
        4,
        12,
        np.float32(4) / np.float32(5),
        np.float32(2) / np.float32(5),
    ]


def test_standing_still_has_a_negative_zero_upwards(world: World, level: LevelMap) -> None:
    still = seen(world, level).doubles
    assert not np.signbit(still[2])
    assert np.signbit(still[3])


def test_full_list_fits_the_body(world: World, level: LevelMap) -> None:
    for slot in range(1, state.ACTORS):
        world.actors[slot].kind = state.GOOMBA
        place(world.actors[slot], slot, slot)
        world.order[slot - 1] = slot
    world.listed = state.ACTORS - 1
    assert len(seen(world, level).body) + 4 == BODY_SIZE
