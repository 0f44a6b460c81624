"""An observation as arrays for learners: the view `tiles` of docs/gymnasium.md."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from agents.mario.observation import COLUMNS, ROWS, decode
from glue.types import Observation

MARIO: Final = 10
"""The number of the tile where Mario is."""

_CODES: Final = np.zeros(256, np.uint8)
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
