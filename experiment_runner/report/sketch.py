"""Learning curves as text, for the terminal."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from experiment_runner.analysis.stats import FloatArray, running_mean
from experiment_runner.report.plots import Key, fitting_window
from experiment_runner.report.tables import counted

_BLOCKS: Final = " ▁▂▃▄▅▆▇█"
_HEIGHT: Final = 8  # lines of a curve
_MIN_COLUMNS: Final = 10


def sketches(curves: Mapping[Key, FloatArray], window: int, measure: str, width: int) -> str:
    """Return the running means over trials, one curve below the other, on one scale for each environment.

    Args:
        curves: (trials, episodes) of each; a curve that is shorter than the window is left out.
        window: episodes in the running mean; a tenth of the longest curve if that is less.
        measure: name of the values.
        width: columns of the terminal.

    Raises:
        ExperimentError: there is nothing to show yet.
    """
    window = fitting_window(window, (values.shape[1] for values in curves.values()))
    means = {key: running_mean(returns, window).mean(axis=0) for key, returns in curves.items()}
    means = {key: curve for key, curve in means.items() if curve.size}
    shown = []
    for key, curve in means.items():
        environment, agent = key
        there = [other for (where, _), other in means.items() if where == environment]
        # Means that are infinite or NaN are left blank.
        drawn = np.concatenate([other[np.isfinite(other)] for other in there])
        scale = (float(drawn.min()), float(drawn.max())) if drawn.size else (0.0, 0.0)
        name = f"{agent}, {environment}" if environment else agent
        title = f"{name}: {measure}, running mean of {counted(window, 'episode')}"
        shown.append(_sketch(title, curve, scale, curves[key].shape[1], width))
    return "\n\n".join(shown)


def _sketch(title: str, means: FloatArray, scale: tuple[float, float], episodes: int, width: int) -> str:
    low, high = scale
    labels = [f"{high:.1f}", *[""] * (_HEIGHT - 2), f"{low:.1f}"]
    margin = max(map(len, labels))
    number = min(max(width - margin - 2, _MIN_COLUMNS), means.size)
    columns = [float(part.mean()) for part in np.array_split(means, number)]
    steps = len(_BLOCKS) - 1
    span = high / 2 - low / 2 or 1.0  # halves, as the difference of two floats may be infinite
    filled = [
        max(1, round((value / 2 - low / 2) / span * steps * _HEIGHT)) if math.isfinite(value) else 0
        for value in columns
    ]
    lines = [title]
    for row, label in enumerate(labels):
        below = steps * (_HEIGHT - 1 - row)
        blocks = "".join(_BLOCKS[min(max(level - below, 0), steps)] for level in filled)
        lines.append(f"{label:>{margin}} |{blocks.rstrip()}")
    end = f"episode {episodes}"
    lines.append(f"{'':>{margin}} +{'-' * max(number - len(end), 0)}{end}")
    return "\n".join(lines)
