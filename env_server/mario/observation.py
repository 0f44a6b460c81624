"""World to observation: Mario, the other actors and the tiles around him, as the agent sees them.

ints    (1 + 2*M,)  left-most column shown, then kind and winged (0 or 1) per actor
doubles (4*M,)      x, y in tiles (y upwards, from one tile below the level), then the velocity
                    of the last tick in tiles per step, per actor
chars   (352,)      16 rows of 21 tile codes and a newline

M counts Mario, who comes first; the others follow in the order of the game's list, newest first.

kind: 0, 10, 11 Mario small, large, with fire; 1 red koopa, 2 green koopa, 3 goomba, 4 spiky,
5 piranha plant, 6 mushroom, 7 fire flower, 8 fireball, 9 shell.

Tile codes: M Mario, ! the goal column, $ coin, b brick, ? question block, | pipe, 7 solid, 1 stops
only falling, 2 stops only rising, 3 both, space nothing.

Source: RL-Competition 2009, Infinite Mario's level check-in; Mohan (2010), appendix A.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from env_server.mario.sim.state import ACTORS, PLANT, ROWS, TICKS_PER_ACTION, Actor, LevelMap, World
from env_server.mario.sim.tiles import LOOK, SHOWN_GOAL, SHOWN_MARIO, cells_at
from glue.compiled.jit import jit
from glue.types import PREFIX_SIZE

ROWS_SHOWN: Final = 16
COLUMNS_SHOWN: Final = 21
_CHARS: Final = ROWS_SHOWN * (COLUMNS_SHOWN + 1)
BODY_SIZE: Final = PREFIX_SIZE + 8 * 4 * ACTORS + 4 * (1 + 2 * ACTORS) + _CHARS + 4
"""Bytes of a buffer for any observation; a multiple of 8."""

_NEWLINE: Final = ord("\n")
_GOAL: Final = sum(SHOWN_GOAL << 4 * row for row in range(ROWS))
_BOTTOM: Final = -1 << 4 * ROWS  # the row below the level, which looks like its last
_EVEN_ROWS: Final = 0x0F0F0F0F0F0F0F0F

Motion = tuple[float, float, float, float]
"""Position and velocity of an actor, as in the doubles of an observation."""

_CHAR_OF_LOOK: Final = np.frombuffer(b" 1237b?|$!M", np.uint8)
"""Shape (11,): the character for each number of a cell, 0 to SHOWN_MARIO."""
CHAR_OF: Final = _CHAR_OF_LOOK[LOOK]
"""Shape (256,): the character for each tile code."""


@jit
def encode(world: World, level: LevelMap, body: npt.NDArray[np.uint8]) -> int:
    """Write the observation as the body of an abstract type (see glue.types); return its length.

    Args:
        body: shape (BODY_SIZE,), contiguous.
    """
    actors = 1 + world.listed
    ints = 1 + 2 * actors
    doubles = 4 * actors
    end_of_doubles = PREFIX_SIZE + 8 * doubles
    end_of_ints = end_of_doubles + 4 * ints
    words = body.view(np.int32)
    words[0] = ints
    words[1] = doubles
    words[2] = _CHARS
    words[3] = 0
    numbers = words[end_of_doubles // 4 :]
    reals = body.view(np.float64)[PREFIX_SIZE // 8 :]
    numbers[0] = world.drawn_camera // 16
    mario = world.actors[0]
    numbers[1] = kind_of_mario(world)
    numbers[2] = 0
    _write_place(world, mario, reals)
    for i in range(world.listed):
        actor = world.actors[world.order[i]]
        numbers[3 + 2 * i] = actor.kind
        numbers[4 + 2 * i] = actor.kind <= PLANT and actor.winged
        _write_place(world, actor, reals[4 + 4 * i :])
    chars = body[end_of_ints : end_of_ints + _CHARS]
    encode_tiles(world, level, chars)
    for row in range(ROWS_SHOWN - 1, -1, -1):  # last row first, as each row moves to make room for newlines
        end = row * (COLUMNS_SHOWN + 1) + COLUMNS_SHOWN
        chars[end] = _NEWLINE
        for j in range(1, COLUMNS_SHOWN + 1):
            chars[end - j] = _CHAR_OF_LOOK[chars[end - j - row]]
    return end_of_ints + _CHARS


@jit
def kind_of_mario(world: World) -> int:
    """Return Mario's kind: 0 small, 10 large, 11 with fire."""
    if world.fire:
        return 11
    return 10 if world.large else 0


@jit
def _write_place(world: World, actor: Actor, reals: npt.NDArray[np.float64]) -> None:
    reals[0], reals[1], reals[2], reals[3] = place_of(world, actor)


@jit
def place_of(world: World, actor: Actor) -> Motion:
    """Return the position and velocity of an actor, as the doubles of an observation."""
    x = np.float64(actor.x) / 16.0
    y = 16.0 - np.float64(actor.y) / 16.0
    dx = actor.x - actor.old_x
    dy = actor.y - actor.old_y
    ticks = np.float32(TICKS_PER_ACTION)
    if world.velocity_of_jar:
        return x, y, np.float64(dx / ticks), np.float64(-dy / ticks)
    return x, y, np.float64(ticks * dx / np.float32(16)), np.float64(-ticks * dy / np.float32(16))


@jit
def encode_tiles(world: World, level: LevelMap, cells: npt.NDArray[np.uint8]) -> None:
    """Write the look of the window of tiles, 16 rows from the top down: 0 to SHOWN_MARIO for each cell.

    Args:
        world, level: the game.
        cells: shape (16 * 21,).
    """
    first = world.drawn_camera // 16
    exit_x = level.exit_x
    for j in range(COLUMNS_SHOWN):
        looks = _GOAL if first + j == exit_x else cells_at(world, level, first + j)
        looks |= looks << 4 & _BOTTOM
        even = looks & _EVEN_ROWS
        odd = looks >> 4 & _EVEN_ROWS
        for pair in range(ROWS_SHOWN // 2):
            cells[2 * pair * COLUMNS_SHOWN + j] = even >> 8 * pair & 15
            cells[(2 * pair + 1) * COLUMNS_SHOWN + j] = odd >> 8 * pair & 15
    actor = world.actors[0]
    j = int(np.float64(actor.x) / 16.0) - first
    row = 15 - int(16.0 - np.float64(actor.y) / 16.0)
    if 0 <= j < COLUMNS_SHOWN and 0 <= row < ROWS_SHOWN:
        cells[row * COLUMNS_SHOWN + j] = SHOWN_MARIO
