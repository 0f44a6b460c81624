"""A learning curve as text, for a look in the terminal."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

__all__ = ["sketch"]

_BLOCKS: Final = " ▁▂▃▄▅▆▇█"
_HEIGHT: Final = 8  # lines


def sketch(name: str, means: npt.NDArray[np.float64], width: int) -> str:
    """Return a curve drawn with blocks, its range and its length beside it.

    Args:
        name: stands above it.
        means: (episodes,), at least one, for example a running mean of returns.
        width: columns of the whole, at least 20.
    """
    low, high = float(means.min()), float(means.max())
    labels = [f"{high:.1f}", *[""] * (_HEIGHT - 2), f"{low:.1f}"]
    margin = max(map(len, labels))
    columns = [float(part.mean()) for part in np.array_split(means, min(width - margin - 2, len(means)))]
    eighths = [
        max(1, round((value - low) / (high - low) * 8 * _HEIGHT)) if high > low else 4 * _HEIGHT
        for value in columns
    ]
    lines = [
        f"{label:>{margin}} |"
        + "".join(_BLOCKS[min(max(filled - 8 * (_HEIGHT - 1 - row), 0), 8)] for filled in eighths).rstrip()
        for row, label in enumerate(labels)
    ]
    axis = f"{'':>{margin}} +{'-' * len(columns)}"
    return "\n".join([name, *lines, axis])
