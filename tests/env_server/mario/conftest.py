"""Small scenes: an empty level with Mario alone in it. Coordinates are pixels, y downwards, 16 per tile."""

from __future__ import annotations

import numpy as np
import pytest

from env_server.mario.game import Game
from env_server.mario.parameters import resolve
from env_server.mario.sim.state import FREE, LevelMap, World
from env_server.mario.sim.tiles import EMPTY, write_cells


@pytest.fixture
def game() -> Game:
    game = Game(resolve({"level_width": 0}))
    game.start()
    return game


@pytest.fixture
def level(game: Game) -> LevelMap:
    """An empty level, with the goal out of reach."""
    level = game.level_map
    level.tiles[:] = EMPTY
    level.spawns[:] = 0
    for column in range(level.columns):
        write_cells(level, column)
    level.exit_x = 1000
    return level


@pytest.fixture
def world(game: Game, level: LevelMap) -> World:
    """Only Mario: small, at (100, 100) in mid-air, facing right."""
    world = game.world
    world.listed = 0
    for slot in range(1, len(world.actors)):
        world.actors[slot].kind = FREE
    mario = world.actors[0]
    mario.vx = mario.vy = np.float32(0)
    mario.x = mario.y = np.float32(100)
    return world
