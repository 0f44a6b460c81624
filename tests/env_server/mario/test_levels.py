"""Levels against digests of the original's, and the properties of every level."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from env_server.mario.environment import InfiniteMario
from env_server.mario.game import Game
from env_server.mario.sim import tiles as tile
from env_server.mario.sim.state import ROWS, LevelMap
from tests.env_server.mario.golden_check import DIGESTS


def level(options: Mapping[str, Any]) -> LevelMap:
    game = Game(InfiniteMario(**options).parameters)
    game.start()
    return game.level_map


def spawn_points(level: LevelMap) -> list[tuple[int, int, int, int]]:
    """Return the column, row, generated kind and wings of each spawn point."""
    return [
        (int(x), int(y), int(level.spawns[x, y]) % 8 - 1, int(level.spawns[x, y]) // 8)
        for x, y in np.argwhere(level.spawns[: level.columns])
    ]


def short_digest(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()[:16]


@pytest.mark.parametrize("known", DIGESTS["levels"], ids=lambda known: str(known["options"]))
def test_level_is_the_original_one(known: dict[str, Any]) -> None:
    made = level(known["options"])
    points = spawn_points(made)
    assert (made.columns, made.exit_x) == (known["columns"], known["exit_x"])
    assert [len(points), sum(winged for *_, winged in points)] == known["counts"]
    assert short_digest(made.tiles[: made.columns].tobytes()) == known["tiles"]
    listed = "".join(f"{x},{y},{kind},{winged};" for x, y, kind, winged in points)
    assert short_digest(listed.encode()) == known["spawns"]


@settings(deadline=None)
@given(
    seed=st.integers(-(2**31), 2**31 - 1),
    kind=st.integers(0, 2),
    difficulty=st.integers(0, 100),
    width=st.integers(0, 2000),
)
def test_every_level_can_be_begun_and_left(seed: int, kind: int, difficulty: int, width: int) -> None:
    task = {"level_seed": seed, "level_type": kind, "level_difficulty": difficulty, "level_width": width}
    made = level(task)
    assert made.columns == width + 50
    assert 0 < made.exit_x < made.columns
    solid = tile.BEHAVIOR[made.tiles[: made.columns]] & tile.STOPS_ALL != 0
    assert solid[2, 5:].any()  # ground below the start
    assert solid[made.exit_x :, made.exit_y].all()  # and behind the goal
    assert not (made.tiles[made.columns :]).any()
    assert all(kind == 4 or not 0 <= x < 10 for x, _, kind, _ in spawn_points(made))


def test_new_level_leaves_nothing_of_the_last() -> None:
    environment = InfiniteMario(level_width=2000, level_type=1, level_difficulty=50)
    environment.env_init()
    environment.env_start()
    environment.env_message("level level_seed=3 level_type=0 level_difficulty=0")
    environment.env_start()
    fresh = level({"level_seed": 3, "level_width": 2000})
    assert np.array_equal(environment.game.level_map.tiles, fresh.tiles)
    assert np.array_equal(environment.game.level_map.spawns, fresh.spawns)


@pytest.mark.parametrize("seed", range(3))
def test_cells_of_a_level_say_what_its_tiles_do_also_where_play_has_changed_them(seed: int) -> None:
    game = Game(InfiniteMario(level_seed=seed, level_type=seed, level_difficulty=5).parameters)
    game.start()
    world, made = game.world, game.level_map
    changed = np.random.default_rng(seed).integers(0, 2, (made.columns, ROWS)) * (
        tile.BEHAVIOR[made.tiles[: made.columns]] & (tile.BUMPABLE | tile.PICKUP) != 0
    )
    world.changed[: made.columns] = changed @ (1 << np.arange(ROWS))
    tiles = np.where(changed, tile.CHANGED[made.tiles[: made.columns]], made.tiles[: made.columns])
    assert changed.any()
    cells = np.array([tile.cells_at(world, made, column) for column in range(made.columns)])
    for lanes, bits in {
        tile.WALLS: tile.STOPS_ALL,
        tile.FLOORS: tile.STOPS_ALL | tile.STOPS_FALL,
        tile.CEILINGS: tile.STOPS_ALL | tile.STOPS_RISE,
        tile.COINS: tile.PICKUP,
    }.items():
        does = cells[:, np.newaxis] >> 4 * np.arange(ROWS) & lanes != 0
        assert np.array_equal(does, tile.BEHAVIOR[tiles] & bits != 0)
