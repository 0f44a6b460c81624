"""Epsilon-greedy choice among the legal actions, for agents in plain Python."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt


def epsilon_greedy(
    generator: np.random.Generator,
    epsilon: float,
    values: Sequence[float],
    mask: npt.NDArray[np.bool_] | None = None,
) -> int:
    """Choose an action: any legal one with the chance to explore, otherwise one of the best of them.

    Args:
        generator: draws whether to explore, then the action if more than one qualifies.
        epsilon: the chance to explore.
        values: of the actions, from 0 on.
        mask: which of them are legal, at least one; further bits are ignored. None if all are legal.
    """
    choices: Sequence[int] = range(len(values))
    if mask is not None:
        choices = np.flatnonzero(mask[: len(values)]).tolist()
        values = [values[choice] for choice in choices]
    if generator.random() < epsilon:
        return choices[generator.integers(len(choices))]
    highest = max(values)
    best = [choice for choice, value in zip(choices, values, strict=True) if value == highest]
    return best[generator.integers(len(best))] if len(best) > 1 else best[0]
