"""The part of the world that an observation shows, where recordings of the original hardly reach."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from env_server.mario.observation import BODY_SIZE, encode
from env_server.mario.sim import state
from env_server.mario.sim.state import Actor, LevelMap, World
from env_server.mario.sim.tiles import COIN, EMPTY, set_tile
from glue.types import Observation


@pytest.fixture
def level(level: LevelMap) -> LevelMap:
    """The level with a floor in its lowest row."""
    for column in range(level.columns):
        set_tile(level, column, 14, 129)
    return level


@pytest.fixture
def world(world: World) -> World:
    """Mario in mid-air at tile (3, 6)."""
    place(world.actors[0], 16 * 3 + 8, 16 * 6 + 8)
    return world


def place(actor: Actor, x: float, y: float) -> None:
    """Put an actor at (x, y) pixels, where it was a tick ago, too."""
    actor.x = actor.old_x = np.float32(x)
    actor.y = actor.old_y = np.float32(y)


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


def test_full_list_fits_the_body(world: World, level: LevelMap) -> None:
    for slot in range(1, state.ACTORS):
        world.actors[slot].kind = state.GOOMBA
        place(world.actors[slot], slot, slot)
        world.order[slot - 1] = slot
    world.listed = state.ACTORS - 1
    assert len(seen(world, level).body) + 4 == BODY_SIZE
