"""Epsilon-greedy choice among the legal actions, for agents in plain Python."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from glue.taskspec import legal_values
from glue.types import Observation


def epsilon_greedy(
    generator: np.random.Generator, epsilon: float, values: Sequence[float], observation: Observation
) -> int:
    """Choose an action of one int: any legal one with the chance to explore, otherwise one of the best.

    Args:
        generator: draws whether to explore, then the action if more than one qualifies.
        epsilon: the chance to explore.
        values: of the actions, from 0 on.
        observation: with the mask of the legal actions, if there is one.

    Raises:
        RemoteProtocolError: the mask does not fit the number of actions.
    """
    choices: Sequence[int] = range(len(values))
    if observation.packed_mask:
        (legal,) = legal_values(observation, (len(values),))
        choices = np.flatnonzero(legal).tolist()
        values = [values[choice] for choice in choices]
    if generator.random() < epsilon:
        return choices[int(generator.integers(len(choices)))]
    highest = max(values)
    best = [choice for choice, value in zip(choices, values, strict=True) if value == highest]
    return best[generator.integers(len(best))] if len(best) > 1 else best[0]
