"""Tile codes, their behaviours, and queries of the grid.

A code is 0 to 255. Source of the table: RL-Competition 2009, Infinite Mario's tile behaviours.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from env_server.mario.sim.state import ROWS, LevelMap, World
from glue.compiled.jit import jit

EMPTY: Final = 0
USED_BLOCK: Final = 4
STAIR: Final = 9
PIPE_MOUTH: Final = 10
PIPE_SHAFT: Final = 26
BRICK: Final = 16
BRICK_WITH_COIN: Final = 17
BRICK_WITH_POWER_UP: Final = 18
QUESTION_WITH_COIN: Final = 21
QUESTION_WITH_POWER_UP: Final = 22
COIN: Final = 34
GROUND: Final = 145
HILL_TOP_LEFT: Final = 132
HILL_TOP_RIGHT: Final = 134
OVERLAPPED_LEFT: Final = 180
OVERLAPPED_RIGHT: Final = 182

STOPS_FALL: Final = 1
STOPS_ALL: Final = 2
STOPS_RISE: Final = 4
SPECIAL: Final = 8
BUMPABLE: Final = 16
BREAKABLE: Final = 32
PICKUP: Final = 64

BEHAVIOR: Final = np.array(
    [
        *(0, 20, 28, 0, 130, 130, 130, 130, 2, 2, 2, 2, 2, 0, 138, 0),
        *(162, 146, 154, 162, 146, 146, 154, 146, 2, 0, 2, 2, 2, 0, 2, 0),
        *(192, 192, 192, 192, 0, 0, 0, 0, 2, 2, 0, 0, 0, 0, 2, 0),
        *(0, 0, 0, 0, 0, 0, 0, 0, 2, 2, 0, 0, 0, 0, 0, 0),
        *(0,) * 64,
        *(2, 2, 2, 0, 1, 1, 1, 0, 2, 2, 2, 0, 2, 2, 2, 0),
        *(2, 0, 2, 0, 0, 0, 0, 0, 2, 2, 2, 0, 2, 2, 2, 0),
        *(2, 2, 2, 0, 0, 0, 0, 0, 2, 2, 2, 0, 2, 2, 2, 0),
        *(2, 2, 2, 0, 1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0),
        *(0,) * 32,
        *(1, 1, 1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0),
        *(0,) * 16,
    ],
    np.uint8,
)
"""Shape (256,): the bits STOPS_FALL to PICKUP of each tile code (128 is cosmetic)."""

CHANGED: Final = np.where(BEHAVIOR & BUMPABLE, USED_BLOCK, EMPTY).astype(np.uint8)
"""Shape (256,): the tile that each changes to in play: hit blocks are used, bricks break, coins are taken."""


@jit
def tile_of(position: np.float32) -> int:
    """Return the column or row of a position in pixels. Rounded towards zero: -15.9 is in tile 0."""
    return int(position / np.float32(16))


@jit
def tile_at(world: World, level: LevelMap, column: int, row: int) -> int:
    """Return the code of a cell. Border columns and the bottom row extend forever; above is nothing."""
    if row < 0:
        return EMPTY
    column = min(max(column, 0), level.columns - 1)
    row = min(row, ROWS - 1)
    code = level.tiles[column, row]
    if world.changed[column] >> row & 1:
        code = CHANGED[code]
    return int(code)


@jit
def behavior_at(world: World, level: LevelMap, column: int, row: int) -> int:
    """Return the behaviour of a cell's tile."""
    return int(BEHAVIOR[tile_at(world, level, column, row)])


@jit
def solid(world: World, level: LevelMap, column: int, row: int, vy: np.float32) -> bool:
    """Return whether a cell stops a body that moves vertically by `vy`, of which the sign counts."""
    return stops(behavior_at(world, level, column, row), vy)


@jit
def stops(behavior: int, vy: np.float32) -> bool:
    """Return whether a tile of this behaviour stops a body that moves vertically by `vy`, as for `solid`."""
    return bool(
        behavior & STOPS_ALL != 0
        or (vy > 0 and behavior & STOPS_FALL != 0)
        or (vy < 0 and behavior & STOPS_RISE != 0)
    )


@jit
def change_tile(world: World, level: LevelMap, column: int, row: int) -> None:
    """Change a cell to the tile in `CHANGED`; outside the level nothing changes."""
    if 0 <= column < level.columns and 0 <= row < ROWS:
        world.changed[column] |= 1 << row
