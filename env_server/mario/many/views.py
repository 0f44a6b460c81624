"""The views of a game: tiles and sprites, planes, pixels or all numbers for a learner, bytes for the wire.

Compiled code writes each as two rows, of bytes and of single-precision numbers, whose lengths `View` holds. A
view shows nothing beyond the game's own observation (`env_server.mario.observation`).

tiles    `tiles`, uint8 (16, 21): 0 nothing, 1 to 3 as in the observation, 4 solid, 5 brick, 6 question block,
         7 pipe, 8 coin, 9 the goal's column, 10 Mario
         `sprites`, float32 (16, 7): Mario, then the others, the nearest first; unused rows are 0.
         present (1), kind, winged, x and y relative to Mario (y upwards), velocity; in tiles and tiles per
         step. In Mario's own row x and y are his position within his tile, 0 to 1.
planes   uint8 (22, 16, 21), 0 or 1: tiles 1 to 10; sprites of kind 1 to 9; winged sprites; Mario is large;
         Mario has fire (the last two everywhere)
pixels   uint8 (64, 64, 3), red, green and blue: 16 of the 21 columns, a tile is 4 by 4
raw      `ints` int32 (513,), `doubles` float64 (1024,), `chars` uint8 (352,), as in the observation and then
         zeros, and `actors`, their number
body     the observation as the body of an abstract type (`glue.types`); `write_view` returns its length
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from env_server.mario.many.pixels import SIZE, draw_pixels
from env_server.mario.observation import (
    BODY_SIZE,
    COLUMNS_SHOWN,
    ROWS_SHOWN,
    encode,
    encode_tiles,
    kind_of_mario,
    place_of,
)
from env_server.mario.sim.state import ACTORS, PLANT, Actor, LevelMap, World
from env_server.mario.sim.tiles import SHOWN_MARIO
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
_KINDS: Final = 9
_WINGED: Final = SHOWN_MARIO + _KINDS
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
    """Write an observation of `world`, by the number of a `View`; return its length in bytes."""
    if view == BODY:
        return encode(world, level, cells)
    if view == TILES:
        encode_tiles(world, level, cells)
        _write_sprites(world, reals)
    elif view == PLANES:
        _write_planes(world, level, cells)
    elif view == PIXELS:
        tiles = np.empty(CELLS, np.uint8)
        encode_tiles(world, level, tiles)
        draw_pixels(world, tiles, cells)
    else:
        _write_raw(world, level, cells)
    return len(cells)


@jit
def _write_sprites(world: World, reals: Reals) -> None:
    reals[:] = np.float32(0)
    mario = world.actors[0]
    x, y, vx, vy = place_of(world, mario)
    _write_sprite(reals, kind_of_mario(world), False, x - np.floor(x), y - np.floor(y), vx, vy)
    # The others are few, so scan them all for the next nearest; of equally distant ones the first.
    last, last_far = -1, -1.0
    for j in range(1, SPRITES):
        found, found_far = -1, np.inf
        for i in range(world.listed):
            actor = world.actors[world.order[i]]
            dx = np.float64(actor.x) - np.float64(mario.x)
            dy = np.float64(actor.y) - np.float64(mario.y)
            far = dx * dx + dy * dy
            if (far > last_far or (far == last_far and i > last)) and far < found_far:
                found, found_far = i, far
        if found < 0:
            return
        actor = world.actors[world.order[found]]
        its_x, its_y, vx, vy = place_of(world, actor)
        row = reals[COLUMNS * j : COLUMNS * (j + 1)]
        _write_sprite(row, actor.kind, _is_winged(actor), its_x - x, its_y - y, vx, vy)
        last, last_far = found, found_far


@jit
def _write_sprite(
    row: Reals, kind: int, winged: bool, x: float, y: float, velocity_x: float, velocity_y: float
) -> None:
    row[0] = 1
    row[1] = kind
    row[2] = winged
    row[3] = x
    row[4] = y
    row[5] = velocity_x
    row[6] = velocity_y


@jit
def _is_winged(actor: Actor) -> bool:
    return bool(actor.kind <= PLANT and actor.winged)


@jit
def _write_planes(world: World, level: LevelMap, cells: Cells) -> None:
    tiles = np.empty(CELLS, np.uint8)
    encode_tiles(world, level, tiles)
    cells[: _LARGE * CELLS] = 0
    cells[_LARGE * CELLS : _FIRE * CELLS] = world.large
    cells[_FIRE * CELLS :] = world.fire
    for cell in range(CELLS):
        if tiles[cell] > 0:
            cells[(tiles[cell] - 1) * CELLS + cell] = 1
    for i in range(world.listed):
        actor = world.actors[world.order[i]]
        x, y, _, _ = place_of(world, actor)
        row = ROWS_SHOWN - 1 - int(np.floor(y))
        column = int(np.floor(x)) - world.drawn_camera // 16
        if 0 <= row < ROWS_SHOWN and 0 <= column < COLUMNS_SHOWN:
            cell = row * COLUMNS_SHOWN + column
            cells[(SHOWN_MARIO + actor.kind - 1) * CELLS + cell] = 1
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
