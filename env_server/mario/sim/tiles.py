"""Tile codes, their behaviours, and queries of the grid.

A code is 0 to 255. Source of the table: RL-Competition 2009, Infinite Mario's tile behaviours.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from env_server.mario.sim.state import ROWS, LevelMap, World
from glue.compiled.jit import jit

EMPTY: Final = 0
HIDDEN_BLOCK: Final = 1
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
"""Shape (256,): the tile that each becomes in play: hit blocks are used, bricks break, coins are taken."""

# How observations show a cell: 0 nothing, 1 stops only falling, 2 stops only rising, 3 both, and these.
SHOWN_SOLID: Final = 4
SHOWN_BRICK: Final = 5
SHOWN_QUESTION: Final = 6
SHOWN_PIPE: Final = 7
SHOWN_COIN: Final = 8
SHOWN_GOAL: Final = 9
SHOWN_MARIO: Final = 10

FLOORS: Final = 0b101
CEILINGS: Final = 0b110
WALLS: Final = 0b100
COINS: Final = 0b1000
"""Masks of these numbers: a cell that stops falling, rising or every motion, or that holds a coin, has a bit
of the mask."""


def _look(code: int) -> int:
    """Return how observations show a tile code."""
    if code == COIN:
        return SHOWN_COIN
    if code in (BRICK, BRICK_WITH_COIN):
        return SHOWN_BRICK
    if code in (QUESTION_WITH_COIN, QUESTION_WITH_POWER_UP):
        return SHOWN_QUESTION
    if code - code % 2 in (PIPE_MOUTH, PIPE_SHAFT):
        return SHOWN_PIPE
    behavior = int(BEHAVIOR[code])
    if behavior & STOPS_ALL:
        return SHOWN_SOLID
    return (behavior & STOPS_FALL != 0) + 2 * (behavior & STOPS_RISE != 0)


LOOK: Final = np.array([_look(code) for code in range(256)], np.uint8)
"""Shape (256,): how observations show each tile code, 0 to SHOWN_COIN."""


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
def row_bit(row: int) -> int:
    """Return the lowest bit of a row's cell, for FLOORS to COINS. Rows extend as in `tile_at`."""
    return 1 << 4 * min(row, ROWS - 1) if row >= 0 else 0


@jit
def cells_at(world: World, level: LevelMap, column: int) -> int:
    """Return the present look of a column's cells, four bits for each row. Columns extend as in `tile_at`."""
    column = min(max(column, 0), level.columns - 1)
    cells = int(level.cells[column])
    changed = int(world.changed[column])
    if changed:  # hit blocks are solid, everything else is gone
        used = _spread(changed & int(level.bumpable[column]))
        cells = cells & ~(_spread(changed) * 15) | used * SHOWN_SOLID
    return cells


@jit
def _spread(bits: int) -> int:
    """Return the bits of the rows, each moved to the lowest of its cell's four bits."""
    bits = (bits | bits << 24) & 0x000000FF000000FF
    bits = (bits | bits << 12) & 0x000F000F000F000F
    bits = (bits | bits << 6) & 0x0303030303030303
    return (bits | bits << 3) & 0x1111111111111111


@jit
def write_cells(level: LevelMap, column: int) -> None:
    """Update the bit fields of a column after its tiles and spawn points were written."""
    cells = 0
    bumpable = 0
    spawning = 0
    for row in range(ROWS):
        code = level.tiles[column, row]
        cells |= int(LOOK[code]) << 4 * row
        bumpable |= int(BEHAVIOR[code] & BUMPABLE != 0) << row
        spawning |= int(level.spawns[column, row] != 0) << row
    level.cells[column] = cells
    level.bumpable[column] = bumpable
    level.spawning[column] = spawning


@jit
def set_tile(level: LevelMap, column: int, row: int, code: int) -> None:
    """Set the tile that a cell inside the level has from the beginning of the game."""
    level.tiles[column, row] = code
    write_cells(level, column)


@jit
def change_tile(world: World, level: LevelMap, column: int, row: int) -> None:
    """Change a cell to the tile in `CHANGED`; outside the level nothing changes."""
    if 0 <= column < level.columns and 0 <= row < ROWS:
        world.changed[column] |= 1 << row
