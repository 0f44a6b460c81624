"""The learning curve of a run, drawn below its cell during the run."""

from __future__ import annotations

import importlib
import math
from collections.abc import Sequence
from typing import Final

from glue.engine.experiment import Experiment
from glue.installed import needing
from glue.system import clock

_SECONDS: Final = 0.5
"""Minimum time in seconds between two drawings."""

_WIDTH, _HEIGHT, _MARGIN = 640, 240, 40
_POINTS: Final = 400
"""Maximum number of points of the curve."""


def run_live(
    experiment: Experiment, episodes: int, max_steps: int = 0, seed: int | None = None
) -> list[float]:
    """Run episodes and draw the mean return below the cell; return the episodes' returns.

    Args:
        experiment: a connected experiment; `rl_init` is called first.
        episodes: number of episodes, 1 or more.
        max_steps: maximum number of steps of an episode; 0 for no limit.
        seed: for `rl_init`.

    Raises:
        ConfigError: this is not a notebook: IPython is not installed.
        GlueError: raised by the verbs of the experiment.
    """
    with needing("notebooks", "run_live draws in a notebook"):
        display = importlib.import_module("IPython.display")
    handle = display.display(display.HTML(""), display_id=True) or display.DisplayHandle()
    experiment.rl_init(seed=seed)
    returns: list[float] = []
    drawn = clock.monotonic()
    for _ in range(episodes):
        experiment.rl_episode(max_steps)
        returns.append(experiment.rl_return())
        if clock.monotonic() - drawn > _SECONDS:
            drawn = clock.monotonic()
            handle.update(display.HTML(draw_curve(returns, episodes)))
    handle.update(display.HTML(draw_curve(returns, episodes)))
    return returns


def draw_curve(returns: Sequence[float], episodes: int, window: int = 0) -> str:
    """Return an SVG drawing of the running mean of returns.

    Args:
        returns: undiscounted returns of the episodes so far; those that are not finite are left out.
        episodes: number of episodes at the right end of the axis.
        window: number of episodes in a mean; 0 for a tenth of the episodes.
    """
    window = window or max(1, episodes // 10)
    shown = [(number, value) for number, value in enumerate(returns, 1) if math.isfinite(value)]
    values = [value for _, value in shown]
    means = [
        math.fsum(part := values[max(0, end - window) : end]) / len(part) for end in range(1, len(values) + 1)
    ]
    low, high = (min(means), max(means)) if means else (0.0, 1.0)
    spread = high - low or 1.0
    stride = max(1, len(means) // _POINTS)
    points = " ".join(
        f"{_MARGIN + number / max(episodes, 1) * (_WIDTH - 2 * _MARGIN):.1f},"
        f"{_HEIGHT - _MARGIN - (mean - low) / spread * (_HEIGHT - 2 * _MARGIN):.1f}"
        for (number, _), mean in list(zip(shown, means, strict=True))[::stride]
    )
    last = f", mean of the last {min(window, len(means))}: {means[-1]:.2f}" if means else ""
    label = f"episode {len(returns)} of {episodes}{last}"
    bottom = _HEIGHT - _MARGIN
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" role="img" aria-label="{label}" '
        f'viewBox="0 0 {_WIDTH} {_HEIGHT}" '
        f'width="{_WIDTH}" font-family="sans-serif" font-size="12" fill="currentColor">'
        f'<path d="M{_MARGIN} {_MARGIN}V{bottom}H{_WIDTH - _MARGIN}" fill="none" stroke="currentColor"/>'
        f'<polyline points="{points}" fill="none" stroke="#1f77b4" stroke-width="2"/>'
        f'<text x="{_MARGIN}" y="20">{label}</text>'
        f'<text x="4" y="{_MARGIN + 4}">{high:.4g}</text><text x="4" y="{bottom}">{low:.4g}</text>'
        f'<text x="{_MARGIN}" y="{_HEIGHT - 12}">1</text>'
        f'<text x="{_WIDTH - _MARGIN}" y="{_HEIGHT - 12}" text-anchor="end">{episodes}</text></svg>'
    )
