"""The observations of Infinite Mario, read as tiles and sprites.

    ints    (1 + 2*M,)  leftmost column in view, then kind and winged of each of M sprites
    doubles (4*M,)      x, y, then horizontal and vertical speed of each sprite
    chars   (352,)      16 rows from top to bottom, each 21 tiles and a newline

Mario is the first sprite. Positions are in tiles, x to the right and y up, speeds in tiles per step.
A tile lies at a world column and a world row, row 0 at the bottom.

`read` is for compiled code; `decode` (everything) and `glimpse` (only Mario) are for plain Python.
Source: RL-Competition 2009, Infinite Mario; Mohan (2010), appendix A.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from typing import Annotated, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from glue.compiled.jit import jit
from glue.compiled.records import Int, Real
from glue.errors import RemoteProtocolError
from glue.types import PREFIX_SIZE, Observation

ROWS: Final = 16
COLUMNS: Final = 21
MAX_SPRITES: Final = 512

OUTSIDE: Final = 0
"""The tile of a place outside the view."""
BLANK: Final = ord(" ")
MARIO: Final = ord("M")
FINISH: Final = ord("!")
COIN: Final = ord("$")
QUESTION: Final = ord("?")
BRICK: Final = ord("b")
PIPE: Final = ord("|")
LEDGE: Final = ord("1")
"""Solid from above only: one can stand on it and jump through it."""
SOLID: Final = ord("7")

RED_KOOPA: Final = 1
GREEN_KOOPA: Final = 2
GOOMBA: Final = 3
SPIKEY: Final = 4
PLANT: Final = 5
MUSHROOM: Final = 6
FIRE_FLOWER: Final = 7
FIREBALL: Final = 8
SHELL: Final = 9

CHARS: Final = ROWS * (COLUMNS + 1)
_FARTHEST: Final = 2.0**31
_PREFIX: Final = PREFIX_SIZE
_COUNTS: Final = struct.Struct("<4I")
_PLACE: Final = struct.Struct("<2d")
_KIND: Final = struct.Struct("<i")


class Sprite:
    """Mario, a monster, an item, a fireball or a shell."""

    kind: Int
    winged: Int
    x: Real
    y: Real
    speed_x: Real
    speed_y: Real


class Screen:
    """One observation. `tiles` is indexed by world row and by columns from the left edge of the view."""

    camera: Int
    mario: Annotated[Sprite, Sprite]
    column: Int
    row: Int
    tiles: Annotated[npt.NDArray[np.uint8], np.uint8, (ROWS, COLUMNS)]
    count: Int
    sprites: Annotated[Sequence[Sprite], Sprite, MAX_SPRITES]


@jit
def read(body: bytes, screen: Screen) -> bool:
    """Fill in `screen` from an observation's body; return False when its layout is not Mario's.

    Mario is kept apart from the other sprites. The tile that he hides reads as blank.
    """
    counts = np.frombuffer(body[:_PREFIX], np.uint32)
    sprites = int(counts[0]) // 2
    if (
        not 1 <= sprites <= MAX_SPRITES
        or counts[0] != 1 + 2 * sprites
        or counts[1] != 4 * sprites
        or counts[2] != CHARS
        or len(body) != _PREFIX + 32 * sprites + 4 + 8 * sprites + CHARS
    ):
        return False
    ints_start = _PREFIX + 32 * sprites
    chars_start = ints_start + 4 + 8 * sprites
    doubles = np.frombuffer(body[_PREFIX:ints_start], np.float64)
    ints = np.frombuffer(body[ints_start:chars_start], np.int32)
    for number in doubles:
        if not abs(number) < _FARTHEST:  # NaN too
            return False

    screen.camera = ints[0]
    _read_sprite(screen.mario, 0, ints, doubles)
    screen.column = int(screen.mario.x)
    screen.row = int(screen.mario.y)
    screen.count = sprites - 1
    for i in range(sprites - 1):
        _read_sprite(screen.sprites[i], i + 1, ints, doubles)
    for row in range(ROWS):
        line = chars_start + (ROWS - 1 - row) * (COLUMNS + 1)
        for k in range(COLUMNS):
            seen = body[line + k]
            screen.tiles[row, k] = BLANK if seen == MARIO else seen
    return True


@jit
def _read_sprite(
    sprite: Sprite, i: int, ints: npt.NDArray[np.int32], doubles: npt.NDArray[np.float64]
) -> None:
    sprite.kind = ints[1 + 2 * i]
    sprite.winged = ints[2 + 2 * i]
    sprite.x = doubles[4 * i]
    sprite.y = doubles[4 * i + 1]
    sprite.speed_x = doubles[4 * i + 2]
    sprite.speed_y = doubles[4 * i + 3]


@jit
def tile(screen: Screen, column: int, row: int) -> int:
    """Return the tile at a world column and row, or OUTSIDE."""
    k = column - screen.camera
    if 0 <= k < COLUMNS and 0 <= row < ROWS:
        return int(screen.tiles[row, k])
    return OUTSIDE


class Seen(NamedTuple):
    """One observation, in plain Python.

    camera   leftmost column in view
    kinds    kind of each sprite, Mario first
    winged   whether each sprite has wings
    doubles  x, y and both speeds of each sprite, one after the other
    chars    the tiles as they were sent, including Mario
    """

    camera: int
    kinds: list[int]
    winged: list[bool]
    doubles: list[float]
    chars: bytes


def decode(observation: Observation) -> Seen:
    """Return an observation in plain Python.

    Raises:
        RemoteProtocolError: the observation is not one of Infinite Mario.
    """
    _end_of_doubles(observation)
    camera, *sprites = observation.ints.tolist()
    doubles = observation.doubles.tolist()
    if not all(abs(number) < _FARTHEST for number in doubles):
        raise malformed(observation)
    return Seen(camera, sprites[::2], [*map(bool, sprites[1::2])], doubles, observation.chars)


def glimpse(observation: Observation) -> tuple[int, tuple[float, float], bytes]:
    """Return Mario's kind, his x and y, and the doubles of all sprites as bytes; faster than `decode`.

    Raises:
        RemoteProtocolError: the observation is not one of Infinite Mario.
    """
    end = _end_of_doubles(observation)
    body = observation.body
    x, y = _PLACE.unpack_from(body, PREFIX_SIZE)
    if not (abs(x) < _FARTHEST and abs(y) < _FARTHEST):
        raise malformed(observation)
    (kind,) = _KIND.unpack_from(body, end + 4)
    return kind, (x, y), body[PREFIX_SIZE:end]


def _end_of_doubles(observation: Observation) -> int:
    """Return the offset in the body at which the doubles end, if the counts are those of Mario."""
    ints, doubles, chars, _ = _COUNTS.unpack_from(observation.body)
    if not 4 <= doubles <= 4 * MAX_SPRITES or doubles % 4 or 2 * ints != doubles + 2 or chars != CHARS:
        raise malformed(observation)
    return PREFIX_SIZE + 8 * int(doubles)


def malformed(observation: Observation) -> RemoteProtocolError:
    """Return the error for an observation that `read` refused."""
    ints, doubles, chars = observation.counts
    expected = f"1 + 2 M ints, 4 M doubles below 2**31 and {CHARS} chars, for M = 1 to {MAX_SPRITES} sprites"
    return RemoteProtocolError(
        f"an observation of Infinite Mario has {expected}; received {ints} ints, {doubles} doubles "
        f"and {chars} chars: is the environment Mario?"
    )
