"""States of the flat agents: a window of tiles, whole or in parts, or all objects at once.

The window is five columns wide and three rows high, with Mario in the middle. A sprite whose position
rounds to a tile of the window is that tile's occupant.
Source: Mohan (2010), sections 5.1 to 5.3; docs/agents.md lists the points that the paper leaves open.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from agents.mario.objects import A_COIN, A_MONSTER, A_PIT, A_QUESTION, Scene, tile_above
from agents.mario.observation import Screen, tile
from agents.sarsa import Keys, extend, feature
from glue.compiled.jit import jit

WINDOW: Final = 15
_COLUMNS: Final = 5
_LEFT: Final = -2
_BELOW: Final = -1

_WHOLE: Final = 11
_PART: Final = 12
_OBJECTS: Final = 13
_SPRITE: Final = 256
"""Added to a sprite's kind to distinguish it from a tile."""
_NOTHING: Final = -(2**31)
"""The mark of the end of a list, or the distance to a missing object."""


@jit
def window_whole(screen: Screen) -> np.uint64:
    """Return one key for the occupants of all tiles of the window."""
    key = feature(_WHOLE)
    for i in range(WINDOW):
        key = extend(key, _symbol(screen, i, _occupant(screen, i)))
    return key


@jit
def window_parts(screen: Screen, keys: Keys) -> int:
    """Fill in one key per tile of the window; return how many.

    A key encodes the tile's place, its occupant, and the occupant's speed minus Mario's, in whole tiles
    per step.
    """
    for i in range(WINDOW):
        occupant = _occupant(screen, i)
        speed_x = -screen.mario.speed_x
        speed_y = -screen.mario.speed_y
        if occupant >= 0:
            speed_x += screen.sprites[occupant].speed_x
            speed_y += screen.sprites[occupant].speed_y
        key = extend(extend(feature(_PART), i), _symbol(screen, i, occupant))
        keys[i] = extend(extend(key, _rounded(speed_x)), _rounded(speed_y))
    return WINDOW


@jit
def all_objects(scene: Scene) -> np.uint64:
    """Return one key for everything that is related to Mario.

    It covers his kind, the tiles to his right and above, every threat in the order of the observation,
    and the distances of the nearest coin, the nearest question and a dangerous pit.
    """
    screen = scene.screen
    key = extend(feature(_OBJECTS), screen.mario.kind)
    key = extend(extend(key, tile(screen, screen.column + 1, screen.row)), tile_above(screen))
    for i in range(scene.count):
        found = scene.objects[i]
        if found.kind == A_MONSTER and found.related:
            key = extend(extend(extend(extend(key, found.type), found.dx), found.dy), found.motion)
    key = extend(key, _NOTHING)
    for kind in (A_COIN, A_QUESTION, A_PIT):
        key = _extend_by_nearest(key, scene, kind)
    return key


@jit
def _extend_by_nearest(key: np.uint64, scene: Scene, kind: int) -> np.uint64:
    nearest = -1
    for i in range(scene.count):
        found = scene.objects[i]
        if found.kind == kind and (nearest < 0 or _distance(scene, i) < _distance(scene, nearest)):
            nearest = i
    if nearest < 0:
        return extend(key, _NOTHING)
    return extend(extend(key, scene.objects[nearest].dx), scene.objects[nearest].dy)


@jit
def _distance(scene: Scene, i: int) -> int:
    return abs(scene.objects[i].dx) + abs(scene.objects[i].dy)


@jit
def _occupant(screen: Screen, i: int) -> int:
    """Return the index of the first sprite at tile `i` of the window, or -1."""
    column = screen.column + _LEFT + i % _COLUMNS
    row = screen.row + _BELOW + i // _COLUMNS
    for k in range(screen.count):
        if _rounded(screen.sprites[k].x) == column and _rounded(screen.sprites[k].y) == row:
            return k
    return -1


@jit
def _symbol(screen: Screen, i: int, occupant: int) -> int:
    """Return the content of a tile of the window: a sprite's kind, or a tile, or OUTSIDE."""
    if occupant >= 0:
        return _SPRITE + screen.sprites[occupant].kind
    return tile(screen, screen.column + _LEFT + i % _COLUMNS, screen.row + _BELOW + i // _COLUMNS)


@jit
def _rounded(number: float) -> int:
    """Return the nearest whole number, halves upwards."""
    return math.floor(number + 0.5)
