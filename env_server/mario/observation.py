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

from env_server.mario.sim import tiles as tile
from env_server.mario.sim.state import ACTORS, PLANT, ROWS, TICKS_PER_ACTION, Actor, LevelMap, World
from env_server.mario.sim.tiles import CHANGED
from glue.compiled.jit import jit
from glue.types import PREFIX_SIZE

ROWS_SHOWN: Final = 16
COLUMNS_SHOWN: Final = 21
_CHARS: Final = ROWS_SHOWN * (COLUMNS_SHOWN + 1)
BODY_SIZE: Final = PREFIX_SIZE + 8 * 4 * ACTORS + 4 * (1 + 2 * ACTORS) + _CHARS + 4
"""More bytes than any observation takes; a multiple of 8."""

_NEWLINE: Final = ord("\n")
_MARIO: Final = ord("M")
_GOAL: Final = ord("!")


def _char_of(code: int) -> int:
    if code == tile.COIN:
        return ord("$")
    if code in (tile.BRICK, tile.BRICK_WITH_COIN):
        return ord("b")
    if code in (tile.QUESTION_WITH_COIN, tile.QUESTION_WITH_POWER_UP):
        return ord("?")
    if code - code % 2 in (tile.PIPE_MOUTH, tile.PIPE_SHAFT):
        return ord("|")
    behavior = int(tile.BEHAVIOR[code])
    digit = 7 if behavior & tile.STOPS_ALL else behavior & tile.STOPS_FALL
    if behavior & tile.STOPS_RISE and digit != 7:
        digit += 2
    return ord(str(digit)) if digit else ord(" ")


CHAR_OF: Final = np.array([_char_of(code) for code in range(256)], np.uint8)


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
    encode_place(world, mario, reals)
    for i in range(world.listed):
        actor = world.actors[world.order[i]]
        numbers[3 + 2 * i] = actor.kind
        numbers[4 + 2 * i] = actor.kind <= PLANT and actor.winged
        encode_place(world, actor, reals[4 + 4 * i :])
    chars = body[end_of_ints:]
    encode_tiles(world, level, CHAR_OF, _GOAL, _MARIO, COLUMNS_SHOWN + 1, chars)
    for row in range(ROWS_SHOWN):
        chars[row * (COLUMNS_SHOWN + 1) + COLUMNS_SHOWN] = _NEWLINE
    return end_of_ints + _CHARS


@jit
def kind_of_mario(world: World) -> int:
    """Return the number that stands for Mario: 0 small, 10 large, 11 with fire."""
    if world.fire:
        return 11
    return 10 if world.large else 0


@jit
def encode_place(world: World, actor: Actor, reals: npt.NDArray[np.float64]) -> None:
    """Write where an actor is and how fast, as the doubles of an observation, shape (4,)."""
    dx = actor.x - actor.old_x
    dy = actor.y - actor.old_y
    ticks = np.float32(TICKS_PER_ACTION)
    reals[0] = np.float64(actor.x) / 16.0
    reals[1] = 16.0 - np.float64(actor.y) / 16.0
    if world.velocity_of_jar:
        reals[2] = dx / ticks
        reals[3] = -dy / ticks
    else:
        reals[2] = ticks * dx / np.float32(16)
        reals[3] = -ticks * dy / np.float32(16)


@jit
def encode_tiles(
    world: World,
    level: LevelMap,
    codes: npt.NDArray[np.uint8],
    goal: int,
    mario: int,
    stride: int,
    cells: npt.NDArray[np.uint8],
) -> None:
    """Write the window of tiles, 16 rows from the top down.

    Args:
        world, level: the game.
        codes: what to write for each tile code, shape (256,).
        goal, mario: what to write for the column of the goal, and where Mario is.
        stride: distance between two rows of `cells`, at least 21.
        cells: shape (16 * stride,).
    """
    first_column = world.drawn_camera // 16
    for j in range(COLUMNS_SHOWN):
        column = min(first_column + j, level.columns - 1)
        if column == level.exit_x:
            for row in range(ROWS_SHOWN):
                cells[row * stride + j] = goal
            continue
        for row in range(ROWS):
            cells[row * stride + j] = codes[level.tiles[column, row]]
        changed = world.changed[column]
        if changed:  # rarely, so the loop above has no branch
            for row in range(ROWS):
                if changed >> row & 1:
                    cells[row * stride + j] = codes[CHANGED[level.tiles[column, row]]]
        cells[ROWS * stride + j] = cells[(ROWS - 1) * stride + j]
    actor = world.actors[0]
    j = int(np.float64(actor.x) / 16.0) - first_column
    row = 15 - int(16.0 - np.float64(actor.y) / 16.0)
    if 0 <= j < COLUMNS_SHOWN and 0 <= row < ROWS_SHOWN:
        cells[row * stride + j] = mario
