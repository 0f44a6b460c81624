"""The views of a game: tiles and sprites, planes, pixels or all numbers for a learner, bytes for the wire.

Each is written by compiled code as two rows, of bytes and of single-precision numbers, of which `View` knows
the shapes. Everything is in the game's own observation (`env_server.mario.observation`), nothing beyond it.

tiles    `tiles`, uint8 (16, 21): 0 nothing, 1 to 3 as in the observation, 4 solid, 5 brick, 6 question block,
         7 pipe, 8 coin, 9 the goal's column, 10 Mario
         `sprites`, float32 (16, 7): Mario, then the others, the nearest first; unused rows are 0.
         present (1), kind, winged, x and y from Mario to it (y upwards), its velocity; in tiles and tiles per
         step. In Mario's own row x and y are where he stands in his tile, 0 to 1.
planes   uint8 (22, 16, 21), 0 or 1: tiles 1 to 10; sprites of kind 1 to 9; winged sprites; Mario is large;
         Mario has fire (the last two everywhere)
pixels   uint8 (64, 64, 3), red, green and blue: 16 of the 21 columns, a tile is 4 by 4
raw      `ints` int32 (513,), `doubles` float64 (1024,), `chars` uint8 (352,), as in the observation and then
         zeros, and `actors`, how many there are
body     the observation as the body of an abstract type (`glue.types`), as long as `write_view` returns
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from env_server.mario.many.pixels import SIZE, draw_pixels
from env_server.mario.observation import (
    BODY_SIZE,
    CHAR_OF,
    COLUMNS_SHOWN,
    ROWS_SHOWN,
    encode,
    encode_place,
    encode_tiles,
    kind_of_mario,
)
from env_server.mario.sim.state import ACTORS, PLANT, Actor, LevelMap, World
from glue.compiled.jit import jit
from glue.types import PREFIX_SIZE

TILES: Final = 0
PLANES: Final = 1
PIXELS: Final = 2
RAW: Final = 3
BODY: Final = 4

CELLS: Final = ROWS_SHOWN * COLUMNS_SHOWN
SPRITES: Final = 16
COLUMNS: Final = 7
GOAL: Final = 9
MARIO: Final = 10
_KINDS: Final = 9
_WINGED: Final = MARIO + _KINDS
_LARGE: Final = _WINGED + 1
_FIRE: Final = _LARGE + 1
PLANE_COUNT: Final = _FIRE + 1

CHARS: Final = ROWS_SHOWN * (COLUMNS_SHOWN + 1)
DOUBLES: Final = 4 * ACTORS
INTS: Final = 1 + 2 * ACTORS
RAW_INTS: Final = 8 * DOUBLES
"""Offset of the ints in a raw view, in bytes; the number of actors and the chars follow."""
RAW_ACTORS: Final = RAW_INTS + 4 * INTS
RAW_CHARS: Final = RAW_ACTORS + 4
_RAW_SIZE: Final = RAW_CHARS + CHARS

_CODE_OF_CHAR: Final = {" ": 0, "1": 1, "2": 2, "3": 3, "7": 4, "b": 5, "?": 6, "|": 7, "$": 8}
_CODES: Final = np.array([_CODE_OF_CHAR[chr(char)] for char in CHAR_OF], np.uint8)


class View(NamedTuple):
    """A kind of observation: its number in compiled code, its bytes and its single-precision numbers."""

    number: int
    bytes: int
    reals: int


VIEWS: Final = {
    "tiles": View(TILES, CELLS, SPRITES * COLUMNS),
    "planes": View(PLANES, PLANE_COUNT * CELLS, 0),
    "pixels": View(PIXELS, SIZE * SIZE * 3, 0),
    "raw": View(RAW, _RAW_SIZE, 0),
}
"""The views of learners, by name."""

Cells = npt.NDArray[np.uint8]
Reals = npt.NDArray[np.float32]


@jit
def write_view(world: World, level: LevelMap, view: int, cells: Cells, reals: Reals) -> int:
    """Write an observation of `world`, by the number of a `View`; return its bytes."""
    if view == BODY:
        return encode(world, level, cells)
    if view == TILES:
        encode_tiles(world, level, _CODES, GOAL, MARIO, COLUMNS_SHOWN, cells)
        _write_sprites(world, reals)
    elif view == PLANES:
        _write_planes(world, level, cells)
    elif view == PIXELS:
        tiles = np.empty(CELLS, np.uint8)
        encode_tiles(world, level, _CODES, GOAL, MARIO, COLUMNS_SHOWN, tiles)
        draw_pixels(world, tiles, cells)
    else:
        _write_raw(world, level, cells)
    return len(cells)


@jit
def _write_sprites(world: World, reals: Reals) -> None:
    mario = world.actors[0]
    place = np.empty(4)
    near = np.empty(SPRITES - 1, np.int64)
    far = np.empty(SPRITES - 1)
    found = 0
    for i in range(world.listed):
        actor = world.actors[world.order[i]]
        dx = np.float64(actor.x) - np.float64(mario.x)
        dy = np.float64(actor.y) - np.float64(mario.y)
        distance = dx * dx + dy * dy
        # The others are few: put each in its place among those before it.
        j = min(found, SPRITES - 1)
        while j > 0 and far[j - 1] > distance:
            if j < SPRITES - 1:
                far[j] = far[j - 1]
                near[j] = near[j - 1]
            j -= 1
        if j < SPRITES - 1:
            far[j] = distance
            near[j] = world.order[i]
            found = min(found + 1, SPRITES - 1)
    reals[:] = np.float32(0)
    encode_place(world, mario, place)
    x, y = place[0], place[1]
    _write_sprite(place, kind_of_mario(world), False, np.floor(x), np.floor(y), reals)
    for j in range(found):
        actor = world.actors[near[j]]
        encode_place(world, actor, place)
        _write_sprite(place, actor.kind, _is_winged(actor), x, y, reals[COLUMNS * (j + 1) :])


@jit
def _write_sprite(
    place: npt.NDArray[np.float64], kind: int, winged: bool, x: float, y: float, reals: Reals
) -> None:
    reals[0] = 1
    reals[1] = kind
    reals[2] = winged
    reals[3] = place[0] - x
    reals[4] = place[1] - y
    reals[5] = place[2]
    reals[6] = place[3]


@jit
def _is_winged(actor: Actor) -> bool:
    return bool(actor.kind <= PLANT and actor.winged)


@jit
def _write_planes(world: World, level: LevelMap, cells: Cells) -> None:
    tiles = np.empty(CELLS, np.uint8)
    encode_tiles(world, level, _CODES, GOAL, MARIO, COLUMNS_SHOWN, tiles)
    cells[: _LARGE * CELLS] = 0
    cells[_LARGE * CELLS : _FIRE * CELLS] = world.large
    cells[_FIRE * CELLS :] = world.fire
    for cell in range(CELLS):
        if tiles[cell] > 0:
            cells[(tiles[cell] - 1) * CELLS + cell] = 1
    place = np.empty(4)
    for i in range(world.listed):
        actor = world.actors[world.order[i]]
        encode_place(world, actor, place)
        row = ROWS_SHOWN - 1 - int(np.floor(place[1]))
        column = int(np.floor(place[0])) - world.drawn_camera // 16
        if 0 <= row < ROWS_SHOWN and 0 <= column < COLUMNS_SHOWN:
            cell = row * COLUMNS_SHOWN + column
            cells[(MARIO + actor.kind - 1) * CELLS + cell] = 1
            if _is_winged(actor):
                cells[_WINGED * CELLS + cell] = 1


@jit
def _write_raw(world: World, level: LevelMap, cells: Cells) -> None:
    body = np.empty(BODY_SIZE, np.uint8)
    encode(world, level, body)
    actors = 1 + world.listed
    at_ints = PREFIX_SIZE + 32 * actors
    at_chars = at_ints + 4 + 8 * actors
    cells[:RAW_CHARS] = 0
    cells[: 32 * actors] = body[PREFIX_SIZE:at_ints]
    cells[RAW_INTS : RAW_INTS + 4 + 8 * actors] = body[at_ints:at_chars]
    cells[RAW_ACTORS:RAW_CHARS].view(np.int32)[0] = actors
    cells[RAW_CHARS:] = body[at_chars : at_chars + CHARS]
