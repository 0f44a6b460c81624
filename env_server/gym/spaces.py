"""Common parts of the Gymnasium environments: their games, and the spaces of views and actions."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from env_server.mario.environment import check_parameters
from env_server.mario.level_sets import LevelSet
from env_server.mario.many.games import DISABLED, MAX_STEPS, SAME_STEP, Games
from env_server.mario.many.pixels import SIZE
from env_server.mario.many.views import (
    CHARS,
    COLUMNS,
    DOUBLES,
    INTS,
    PLANE_COUNT,
    RAW_ACTORS,
    RAW_CHARS,
    RAW_INTS,
    SPRITES,
    VIEWS,
    Cells,
    Reals,
)
from env_server.mario.observation import COLUMNS_SHOWN, ROWS_SHOWN
from env_server.mario.sim.state import ACTORS
from env_server.mario.sim.tiles import SHOWN_MARIO
from glue.errors import ConfigError, SimulatorError

_WINDOW: Final = (ROWS_SHOWN, COLUMNS_SHOWN)
CHOICES: Final = {"buttons": np.array([3, 2, 2]), "discrete": np.array([12])}
"""Number of values of direction, jump and run, or of the action number, 4 * direction + 2 * jump + run."""


def observation_space(view: str) -> spaces.Space[Any]:
    """Return the space of a view of one game."""
    if view == "tiles":
        return spaces.Dict(
            tiles=spaces.Box(0, SHOWN_MARIO, _WINDOW, np.uint8),
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
    if action not in tuple(CHOICES):  # `action` may be of any type
        raise ConfigError(f"action is one of {', '.join(CHOICES)}, not {action!r:.80}")
    choices = CHOICES[action]
    return spaces.MultiDiscrete(choices) if action == "buttons" else spaces.Discrete(int(choices[0]))


def unpack(view: str, cells: Cells, reals: Reals) -> Any:
    """Return rows of a view, shapes (..., bytes) and (..., reals), as observations, without copying."""
    rows = cells.shape[:-1]
    if view == "tiles":
        return {"tiles": cells.reshape(*rows, *_WINDOW), "sprites": reals.reshape(*rows, SPRITES, COLUMNS)}
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


def read_actions(action: str, given: object, count: int) -> npt.NDArray[np.int64]:
    """Return `count` actions as rows, shape (count, 3) or (count, 1); their numbers are not checked yet.

    Args:
        action: the name of the action space.
        given: one action, or an array of `count` actions.
        count: number of actions; 0 for a single action that is not in an array.

    Raises:
        SimulatorError: `given` has another shape or type.
    """
    actions = np.asarray(given)
    shape = (count,) * (count > 0) + (3,) * (action == "buttons")
    if actions.shape != shape or actions.dtype.kind not in "iu":
        expected = "an action" if not count else f"{count} action{'s' * (count > 1)}"
        one = "MultiDiscrete([3, 2, 2])" if action == "buttons" else "Discrete(12)"
        raise SimulatorError(
            f"expected {expected} of {one}, integers of shape {shape}; "
            f"received shape {actions.shape} of {actions.dtype}: {given!r:.80}"
        )
    return actions.astype(np.int64, copy=False).reshape(count or 1, -1)


def what_is_wrong_with(action: str, row: npt.NDArray[np.int64]) -> str:
    """Return an error message for a row of `read_actions` that is not in the space."""
    ranges = "direction 0 to 2, jump and run 0 or 1" if action == "buttons" else "0 to 11"
    return f"an action is {ranges}; received {row.tolist() if action == 'buttons' else int(row[0])}"


def make_games(
    count: int,
    view: str,
    options: dict[str, Any],
    *,
    mode: int = DISABLED,
    threads: int = 1,
    max_episode_steps: int | None = None,
    levels: LevelSet | None,
) -> Games:
    """Return N games of a task.

    Args:
        count: N.
        view: name of a view.
        options: those of `InfiniteMario`.
        max_episode_steps: steps after which an episode is cut off; None for no such limit.
        mode, threads: see `Games`.
        levels: a set of levels to choose from; None for the task's own level.

    Raises:
        ConfigError, SimulatorError: an argument is out of bounds, or two contradict each other.
    """
    if view not in tuple(VIEWS):  # `view` may be of any type
        raise ConfigError(f"observation is one of {', '.join(VIEWS)}, not {view!r:.80}")
    if max_episode_steps is not None and not 1 <= max_episode_steps <= MAX_STEPS:
        raise ConfigError(f"max_episode_steps must be from 1 to {MAX_STEPS}, not {max_episode_steps}")
    for name in ("level_seed", "level"):
        if levels is not None and name in options:
            raise ConfigError(f"{name} is one level: leave it out, or levels, num_levels and start_level")
    # NumPy's numbers become Python's.
    options = {name: v.item() if isinstance(v, np.generic) else v for name, v in options.items()}
    return Games(
        [check_parameters(options)] * count,
        VIEWS[view],
        mode,
        threads=threads,
        max_steps=max_episode_steps or MAX_STEPS,
        levels=levels,
        level_type=options.get("level_type", -1),
        level_difficulty=options.get("level_difficulty", -1),
        finals=mode == SAME_STEP,
    )
