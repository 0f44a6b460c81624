"""The games of the Gymnasium environments, made from keyword arguments."""

from __future__ import annotations

from typing import Any

import numpy as np

from env_server.mario.environment import check_parameters
from env_server.mario.level_sets import resolve_levels
from env_server.mario.many.games import DISABLED, MAX_STEPS, SAME_STEP, Games
from env_server.mario.many.views import VIEWS
from glue.errors import ConfigError


def make_games(
    count: int,
    view: str,
    options: dict[str, Any],
    *,
    mode: int = DISABLED,
    threads: int = 1,
    max_episode_steps: int | None = None,
    levels: str | None = None,
    num_levels: int | None = None,
    start_level: int | None = None,
) -> Games:
    """Return N games of a task.

    Args:
        count: N.
        view: name of a view.
        options: those of `InfiniteMario`.
        max_episode_steps: steps after which an episode is cut off; None for no such limit.
        mode, threads: see `Games`.
        levels, num_levels, start_level: see `env_server.mario.level_sets`.

    Raises:
        ConfigError, SimulatorError: an argument is out of bounds, or two contradict each other.
    """
    if view not in tuple(VIEWS):  # `view` may be of any type
        raise ConfigError(f"observation is one of {', '.join(VIEWS)}, not {view!r:.80}")
    if max_episode_steps is not None and not 1 <= max_episode_steps <= MAX_STEPS:
        raise ConfigError(f"max_episode_steps must be from 1 to {MAX_STEPS}, not {max_episode_steps}")
    chosen = resolve_levels(levels, num_levels, start_level)
    for name in ("level_seed", "level"):
        if chosen is not None and name in options:
            raise ConfigError(f"{name} is one level: leave it out, or levels, num_levels and start_level")
    options = {name: _plain(value) for name, value in options.items()}
    return Games(
        [check_parameters(options)] * count,
        VIEWS[view],
        mode,
        threads=threads,
        max_steps=max_episode_steps or MAX_STEPS,
        levels=chosen,
        level_type=options.get("level_type", -1),
        level_difficulty=options.get("level_difficulty", -1),
        finals=mode == SAME_STEP,
    )


def _plain(value: Any) -> Any:
    """Return a NumPy number as a Python number, and any other value unchanged."""
    return value.item() if isinstance(value, np.generic) else value
