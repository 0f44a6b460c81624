"""Levels against digests of the original's, and the properties of every level."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from env_server.mario.environment import InfiniteMario
from env_server.mario.game import Game
from env_server.mario.sim.state import ROWS, LevelMap
from env_server.mario.sim.tiles import (
    BEHAVIOR,
    BUMPABLE,
    CEILINGS,
    CHANGED,
    COINS,
    FLOORS,
    GROUND,
    PICKUP,
    STOPS_ALL,
    STOPS_FALL,
    STOPS_RISE,
    WALLS,
    cells_at,
)

Options = dict[str, int | str]


def level(options: Options) -> LevelMap:
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


@pytest.mark.parametrize(
    ("options", "columns", "exit_x", "counts", "tiles", "spawns"),
    [
        ({}, 370, 317, (4, 0), "d88210d23f1310bc", "502418047e7c9113"),
        ({"mdp": "proving-1"}, 370, 319, (4, 0), "4a6385bb768fbb05", "0fbb08ac917d74d4"),
        ({"mdp": "proving-2"}, 370, 320, (13, 2), "051616f2d560443e", "842fe6a8dc6b8216"),
        ({"mdp": "proving-3"}, 370, 314, (21, 3), "e19fcfbf152befd8", "a20e848fab3652a2"),
        ({"mdp": "proving-4"}, 370, 320, (56, 12), "99399fe3150d5f96", "5649b2e4d878568f"),
        ({"mdp": "proving-5"}, 370, 323, (52, 15), "0fa71ad59dda6c19", "f2b5816a90053092"),
        ({"mdp": "proving-6"}, 370, 319, (35, 4), "f9dc0e852c78fc93", "f4e7dc46633853c7"),
        ({"mdp": "proving-7"}, 370, 319, (29, 3), "1d1e76d60255ccf5", "9ad1959c988c036a"),
        ({"mdp": "proving-8"}, 370, 320, (27, 5), "aa8d2335190cdbf6", "143142bc1d130ac2"),
        ({"mdp": "proving-9"}, 550, 496, (30, 2), "0adcbdf4e92d0a29", "1352fb0393ac0208"),
        ({"mdp": "proving-10"}, 550, 499, (75, 30), "5ca905e8598f1d98", "a02c628b52da51ee"),
        ({"mdp": "testing-1"}, 370, 315, (15, 0), "e06f8d9d633b20fd", "f973fdc375364427"),
        ({"mdp": "testing-2"}, 370, 322, (22, 2), "e7a317c1b3559088", "20a33ad64e1de5f5"),
        ({"mdp": "testing-3"}, 370, 315, (37, 8), "a975a055c38ddd3b", "a02187f7e48f692f"),
        ({"mdp": "testing-4"}, 370, 314, (48, 10), "4710515e81af65b4", "2f8958f2013df3e5"),
        ({"mdp": "testing-5"}, 370, 322, (78, 18), "3c2ea9561ee65cf7", "78e6ed8b71d3e3b2"),
        ({"mdp": "testing-6"}, 370, 320, (43, 8), "f5e6572670ca4e04", "b4f01e1c9088bc4f"),
        ({"mdp": "testing-7"}, 370, 320, (24, 9), "caf94f9ce02e900f", "0541d6910d9fd3bd"),
        ({"mdp": "testing-8"}, 370, 318, (38, 4), "8fd788fdfe722572", "8fbd5a9de896b390"),
        ({"mdp": "testing-9"}, 550, 504, (29, 4), "2b38a0e9ea3f5465", "ed35d9dc445eb626"),
        ({"mdp": "testing-10"}, 550, 500, (116, 34), "a63151d8295d6a2f", "d43f16e991a6062a"),
        (
            {"level_seed": -7, "level_type": 2, "level_difficulty": 20, "level_width": 620},
            *(670, 618, (72, 24), "b28b62ebe3987745", "8829cb3b7a5f6397"),
        ),
        (
            {"level_seed": 0, "level_type": 1, "level_difficulty": 1, "level_width": 20},
            *(70, 21, (0, 0), "bf265d12458412e5", "e3b0c44298fc1c14"),
        ),
        (
            {"level_seed": 2147483647, "level_difficulty": 3, "level_width": 150},
            *(200, 154, (6, 0), "91acd545138e3f29", "02af39824e1f0022"),
        ),
    ],
)
def test_level_is_the_original_one(
    options: Options, columns: int, exit_x: int, counts: tuple[int, int], tiles: str, spawns: str
) -> None:
    made = level(options)
    points = spawn_points(made)
    assert (made.columns, made.exit_x) == (columns, exit_x)
    assert (len(points), sum(winged for *_, winged in points)) == counts
    assert short_digest(made.tiles[: made.columns].tobytes()) == tiles
    listed = "".join(f"{x},{y},{kind},{winged};" for x, y, kind, winged in points)
    assert short_digest(listed.encode()) == spawns


@settings(deadline=None)
@given(
    seed=st.integers(-(2**31), 2**31 - 1),
    kind=st.integers(0, 2),
    difficulty=st.integers(0, 100),
    width=st.integers(0, 2000),
)
def test_every_level_can_be_begun_and_left(seed: int, kind: int, difficulty: int, width: int) -> None:
    made = level(
        {
            "level_seed": seed,
            "level_type": kind,
            "level_difficulty": difficulty,
            "level_width": width,
        }
    )
    assert made.columns == width + 50
    assert 0 < made.exit_x < made.columns
    solid = BEHAVIOR[made.tiles[: made.columns]] & STOPS_ALL != 0
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


def test_ground_is_dressed_in_the_colour_of_its_type() -> None:
    inner = [GROUND + dress for dress in (0, 12, 8)]
    for kind, code in enumerate(inner):
        tiles = level({"level_type": kind}).tiles[:370]
        assert (tiles == code).any()
        assert not np.isin(tiles, [other for other in inner if other not in (code, GROUND)]).any()


@pytest.mark.parametrize("seed", range(3))
def test_cells_of_a_level_say_what_its_tiles_do_also_where_play_has_changed_them(seed: int) -> None:
    game = Game(InfiniteMario(level_seed=seed, level_type=seed, level_difficulty=5).parameters)
    game.start()
    world, made = game.world, game.level_map
    changed = np.random.default_rng(seed).integers(0, 2, (made.columns, ROWS)) * (
        BEHAVIOR[made.tiles[: made.columns]] & (BUMPABLE | PICKUP) != 0
    )
    world.changed[: made.columns] = changed @ (1 << np.arange(ROWS))
    tiles = np.where(changed, CHANGED[made.tiles[: made.columns]], made.tiles[: made.columns])
    assert changed.any()
    cells = np.array([cells_at(world, made, column) for column in range(made.columns)])
    for lanes, bits in {
        WALLS: STOPS_ALL,
        FLOORS: STOPS_ALL | STOPS_FALL,
        CEILINGS: STOPS_ALL | STOPS_RISE,
        COINS: PICKUP,
    }.items():
        does = cells[:, np.newaxis] >> 4 * np.arange(ROWS) & lanes != 0
        assert np.array_equal(does, BEHAVIOR[tiles] & bits != 0)
