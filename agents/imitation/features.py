"""The inputs of the network: the tiles around Mario, the nearest sprites, himself, and his last actions."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from agents.mario.actions import NUM_ACTIONS
from agents.mario.views import MARIO

RECENT: Final = 5
"""How many of the last actions are seen: they tell how long the buttons have been held."""
NONE: Final = NUM_ACTIONS
"""The number of an action that is not there, at the beginning of an episode."""

_ACROSS: Final = np.arange(-3, 12)  # columns and rows from Mario
_DOWN: Final = np.arange(-9, 7)
_ROWS: Final = slice(1, 16)
_BELOW: Final = 14  # rows below it are a pit, or show the lowest row again
_MIDDLE: Final = 10  # Mario's column when he cannot be seen: above the screen
_OTHERS: Final = 6
_KINDS: Final = np.arange(1, 10)
_SOLID, _LEDGE, _GOAL = (
    np.isin(np.arange(11), some).astype(np.float32) for some in ([2, 4, 5, 6, 7], [1, 3], [9])
)
_ACTIONS: Final = np.eye(NUM_ACTIONS + 1, NUM_ACTIONS, dtype=np.float32)
_NEAR: Final = 0.2  # 1 / tiles

Reals = npt.NDArray[np.float32]


def features(tiles: npt.NDArray[np.uint8], sprites: Reals, recent: npt.NDArray[np.int64]) -> Reals:
    """Return the network's input, shape (N, F).

    Args:
        tiles, sprites: the view `tiles` of N games, shapes (N, 16, 21) and (N, 16, 7).
        recent: the numbers of the last actions, the newest first, shape (N, RECENT).
    """
    count = len(tiles)
    games = np.arange(count)
    found = (tiles == MARIO).reshape(count, -1)
    place = found.argmax(1)
    seen = found[games, place]
    row, column = np.where(seen, place // 21, 0), np.where(seen, place % 21, _MIDDLE)
    columns = np.clip(column[:, None] + _ACROSS, 0, 20)
    heights = row[:, None] + _DOWN
    framed = np.zeros((count, 18, 21), np.uint8)  # nothing above the screen and below it
    framed[:, 1:17] = tiles
    around = framed[games[:, None, None], (np.clip(heights, -1, 16) + 1)[:, :, None], columns[:, None, :]]
    level = np.take_along_axis(tiles[:, _ROWS], columns[:, None, :], 2)
    mario, others = sprites[:, 0], sprites[:, 1 : 1 + _OTHERS]
    parts = [
        _SOLID[around],
        _LEDGE[around],
        _GOAL[level[:, 0]],
        row[:, None] == np.arange(16),
        heights > _BELOW,
        others[..., 1:2] == _KINDS,
        others[..., [0, 2]],
        others[..., 3:] * _NEAR,
        mario[:, 1:2] == [10, 11],  # large, with fire
        mario[:, 3:],
        _ACTIONS[recent],
    ]
    return np.concatenate([np.asarray(part, np.float32).reshape(count, -1) for part in parts], 1)


def remember(recent: npt.NDArray[np.int64], actions: npt.NDArray[np.int64] | int) -> None:
    """Let `actions`, one for each of N games, be the newest in `recent`, shape (N, RECENT)."""
    recent[:, 1:] = recent[:, :-1].copy()
    recent[:, 0] = actions


FEATURES: Final = features(
    np.zeros((1, 16, 21), np.uint8), np.zeros((1, 16, 7), np.float32), np.zeros((1, RECENT), np.int64)
).shape[1]
"""The network's inputs."""
