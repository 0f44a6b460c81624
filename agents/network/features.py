"""The inputs of a network: the tiles around Mario, the nearest sprites, Mario and his last actions.

They are made from the view `tiles` of docs/gymnasium.md.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from agents.mario.agent import NUM_ACTIONS
from agents.mario.observation import COLUMNS, ROWS, decode
from glue.compiled.jit import entry
from glue.types import Observation

Reals = npt.NDArray[np.float32]

RECENT: Final = 5
"""Number of the last actions among the inputs; they tell how long the buttons have been held."""
NONE: Final = NUM_ACTIONS
"""The number of a missing action, at the beginning of an episode."""

_MIDDLE: Final = 10  # Mario's column when he cannot be seen: above the screen
_HEIGHT: Final = 16  # rows around Mario
_ABOVE: Final = 9  # of them above him
_WIDTH: Final = 15  # columns around Mario
_BEHIND: Final = 3  # of them behind him
_LOWEST: Final = 14  # rows below it are a pit, or show the lowest row again
_GOAL_ROW: Final = 1  # the goal's column is shown in all rows
_OTHERS: Final = 6
_KINDS: Final = 9
_NUMBERS: Final = 4  # of a sprite: place and velocity
_LARGE: Final = 10  # Mario's kinds
_WITH_FIRE: Final = 11
_NEAR: Final = np.float32(0.2)  # 1 / tiles

_SOLID: Final = np.isin(np.arange(11), [2, 4, 5, 6, 7])
_LEDGE: Final = np.isin(np.arange(11), [1, 3])
_GOAL: Final = 9

_AT_LEDGES: Final = _HEIGHT * _WIDTH
_AT_GOAL: Final = 2 * _AT_LEDGES
_AT_ROW: Final = _AT_GOAL + _WIDTH
_AT_PITS: Final = _AT_ROW + ROWS
_AT_KINDS: Final = _AT_PITS + _HEIGHT
_AT_FLAGS: Final = _AT_KINDS + _OTHERS * _KINDS  # present, winged
_AT_OTHERS: Final = _AT_FLAGS + _OTHERS * 2
_AT_MARIO: Final = _AT_OTHERS + _OTHERS * _NUMBERS
_AT_ACTIONS: Final = _AT_MARIO + 2 + _NUMBERS

FEATURES: Final = _AT_ACTIONS + RECENT * NUM_ACTIONS
"""The number of inputs."""
MARIO: Final = 10
"""The number of the tile where Mario is."""
_CODES: Final = np.zeros(256, np.uint8)


def features(tiles: npt.NDArray[np.uint8], sprites: Reals, recent: npt.NDArray[np.int64]) -> Reals:
    """Return the network's input, shape (N, FEATURES).

    Args:
        tiles, sprites: the view `tiles` of N games, shapes (N, 16, 21) and (N, 16, 7).
        recent: the numbers of the last actions, the newest first, shape (N, RECENT).
    """
    seen = np.zeros((len(tiles), FEATURES), np.float32)
    _write(tiles, sprites, recent, seen)
    return seen


@entry
def _write(tiles: npt.NDArray[np.uint8], sprites: Reals, recent: npt.NDArray[np.int64], seen: Reals) -> None:
    """Write the inputs of N games to `seen`, which holds zeros."""
    for game in range(len(tiles)):
        to = seen[game]
        row, column = 0, _MIDDLE
        for cell in range(ROWS * COLUMNS):
            if tiles[game, cell // COLUMNS, cell % COLUMNS] == MARIO:
                row, column = cell // COLUMNS, cell % COLUMNS
                break
        to[_AT_ROW + row] = 1
        for i in range(_HEIGHT):
            from_row = row + i - _ABOVE
            to[_AT_PITS + i] = from_row > _LOWEST
            for j in range(_WIDTH if 0 <= from_row < ROWS else 0):
                tile = tiles[game, from_row, min(max(column + j - _BEHIND, 0), COLUMNS - 1)]
                to[i * _WIDTH + j] = _SOLID[tile]
                to[_AT_LEDGES + i * _WIDTH + j] = _LEDGE[tile]
        for j in range(_WIDTH):
            tile = tiles[game, _GOAL_ROW, min(max(column + j - _BEHIND, 0), COLUMNS - 1)]
            to[_AT_GOAL + j] = tile == _GOAL
        for j in range(_OTHERS):
            sprite = sprites[game, 1 + j]
            if 1 <= sprite[1] <= _KINDS:
                to[_AT_KINDS + j * _KINDS + int(sprite[1]) - 1] = 1
            to[_AT_FLAGS + 2 * j] = sprite[0]
            to[_AT_FLAGS + 2 * j + 1] = sprite[2]
            for k in range(_NUMBERS):
                to[_AT_OTHERS + j * _NUMBERS + k] = sprite[3 + k] * _NEAR
        mario = sprites[game, 0]
        to[_AT_MARIO] = mario[1] == _LARGE
        to[_AT_MARIO + 1] = mario[1] == _WITH_FIRE
        to[_AT_MARIO + 2 : _AT_ACTIONS] = mario[3:]
        for j in range(RECENT):
            if recent[game, j] != NONE:
                to[_AT_ACTIONS + j * NUM_ACTIONS + recent[game, j]] = 1


def remember(recent: npt.NDArray[np.int64], actions: npt.NDArray[np.int64] | int) -> None:
    """Make `actions`, one for each of N games, the newest in `recent`, shape (N, RECENT)."""
    recent[:, 1:] = recent[:, :-1].copy()
    recent[:, 0] = actions


_CODES[list(b" 1237b?|$!M")] = np.arange(11)


def tiles_and_sprites(observation: Observation) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.float32]]:
    """Return the tiles, shape (1, 16, 21), and the sprites, shape (1, 16, 7).

    Raises:
        RemoteProtocolError: the observation is not one of Infinite Mario.
    """
    seen = decode(observation)
    tiles = _CODES[np.frombuffer(seen.chars, np.uint8)].reshape(1, ROWS, COLUMNS + 1)[:, :, :COLUMNS]
    places = np.array(seen.doubles).reshape(-1, 4)
    rows: Any = np.column_stack([np.ones(len(places)), seen.kinds, seen.winged, places])
    rows[0, 3:5] -= np.floor(rows[0, 3:5])
    rows[1:, 3:5] -= places[0, :2]
    nearest = np.argsort(np.hypot(rows[1:, 3], rows[1:, 4]), kind="stable")
    rows[1:] = rows[1:][nearest]
    sprites = np.zeros((1, 16, 7), np.float32)
    sprites[0, : len(rows)] = rows[:16]
    return tiles, sprites
