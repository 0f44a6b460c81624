"""The spaces of Infinite Mario's views and actions, and how the rows of a view fill an observation."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from env_server.gym.pixels import SIZE
from env_server.gym.views import (
    CHARS,
    COLUMNS,
    DOUBLES,
    INTS,
    MARIO,
    PLANE_COUNT,
    RAW_ACTORS,
    RAW_CHARS,
    RAW_INTS,
    SPRITES,
    Cells,
    Reals,
)
from env_server.mario.observation import COLUMNS_SHOWN, ROWS_SHOWN
from env_server.mario.sim.state import ACTORS
from glue.errors import ConfigError, SimulatorError

__all__ = ["action_space", "observation_space", "read_action", "read_actions", "unpack"]

_WINDOW: Final = (ROWS_SHOWN, COLUMNS_SHOWN)
_CHOICES: Final = np.array([3, 2, 2])
_BUTTONS: Final = np.array([(d, j, r) for d in (-1, 0, 1) for j in (0, 1) for r in (0, 1)], np.int64)
"""Direction, jump and run of each action of the discrete space, shape (12, 3)."""
_ROW_OF: Final = np.array([4, 2, 1])
"""What direction, jump and run count for in the number of that action."""


def observation_space(view: str) -> spaces.Space[Any]:
    """Return the space of a view of one game."""
    if view == "tiles":
        return spaces.Dict(
            tiles=spaces.Box(0, MARIO, _WINDOW, np.uint8),
            sprites=spaces.Box(-np.inf, np.inf, (SPRITES, COLUMNS), np.float32),
        )
    if view == "planes":
        return spaces.Box(0, 1, (PLANE_COUNT, *_WINDOW), np.uint8)
    if view == "pixels":
        return spaces.Box(0, 255, (SIZE, SIZE, 3), np.uint8)
    return spaces.Dict(
        actors=spaces.Box(1, ACTORS, (1,), np.int32),
        chars=spaces.Box(0, 255, (CHARS,), np.uint8),
        doubles=spaces.Box(-np.inf, np.inf, (DOUBLES,), np.float64),
        ints=spaces.Box(-(2**31), 2**31 - 1, (INTS,), np.int32),
    )


def action_space(action: str) -> spaces.Space[Any]:
    """Return the space of actions called `buttons` or `discrete`.

    Raises:
        ConfigError: there is no such space.
    """
    if action == "buttons":
        return spaces.MultiDiscrete(_CHOICES)
    if action == "discrete":
        return spaces.Discrete(len(_BUTTONS))
    raise ConfigError(f"action is one of buttons, discrete, not {action!r:.80}")


def unpack(view: str, cells: Cells, reals: Reals) -> Any:
    """Return rows of a view as observations: of shapes (..., bytes) and (..., reals), without copying."""
    rows = cells.shape[:-1]
    if view == "tiles":
        return {
            "tiles": cells.reshape(*rows, *_WINDOW),
            "sprites": reals.reshape(*rows, SPRITES, COLUMNS),
        }
    if view == "planes":
        return cells.reshape(*rows, PLANE_COUNT, *_WINDOW)
    if view == "pixels":
        return cells.reshape(*rows, SIZE, SIZE, 3)
    return {
        "actors": cells[..., RAW_ACTORS:RAW_CHARS].view(np.int32),
        "chars": cells[..., RAW_CHARS : RAW_CHARS + CHARS],
        "doubles": cells[..., :RAW_INTS].view(np.float64),
        "ints": cells[..., RAW_INTS:RAW_ACTORS].view(np.int32),
    }


def read_action(action: str, given: object) -> npt.NDArray[np.int64]:
    """Return the buttons of one action, shape (1, 3).

    Raises:
        SimulatorError: it is not in the space.
    """
    return _read(action, given, "an action", ())


def read_actions(action: str, given: object, count: int) -> npt.NDArray[np.int64]:
    """Return the buttons of `count` actions, shape (count, 3): direction -1 to 1, jump and run 0 or 1.

    Raises:
        SimulatorError: one is not in the space.
    """
    return _read(action, given, f"{count} action{'s' * (count > 1)}", (count,))


def _read(action: str, given: object, expected: str, games: tuple[int, ...]) -> npt.NDArray[np.int64]:
    actions = np.asarray(given)
    shape, limits = ((*games, 3), _CHOICES) if action == "buttons" else (games, len(_BUTTONS))
    if actions.shape != shape or actions.dtype.kind not in "iu":
        one = "MultiDiscrete([3, 2, 2])" if action == "buttons" else "Discrete(12)"
        raise SimulatorError(
            f"expected {expected} of {one}, integers of shape {shape}; "
            f"received shape {actions.shape} of {actions.dtype}: {given!r:.80}"
        )
    wrong = (actions < 0) | (actions >= limits)
    if wrong.any():
        ranges = "direction 0 to 2, jump and run 0 or 1" if action == "buttons" else "0 to 11"
        place = tuple(np.argwhere(wrong)[0][: len(games)].tolist())
        whose = f" for game {place[0]}" if games else ""
        raise SimulatorError(f"an action is {ranges}; received {actions[place].tolist()}{whose}")
    rows = actions.astype(np.int64) @ _ROW_OF if action == "buttons" else actions
    buttons: npt.NDArray[np.int64] = _BUTTONS[rows.reshape(-1)]
    return buttons
