"""Compare the recorded outcomes of steps with those of an environment that executes the same actions again.

Replays of recordings, of the original's recordings and of competition records all compare by this rule: bit
for bit, so that 0.0 differs from -0.0.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt


class Outcomes(NamedTuple):
    """The outcomes of consecutive steps of an episode.

    Attributes:
        rewards: shape (steps,).
        terminal: whether the last step was terminal; None if a recording leaves that open.
    """

    rewards: npt.NDArray[np.float64]
    terminal: bool | None


def compare(recorded: Outcomes, again: Outcomes) -> tuple[int, str] | None:
    """Return the index of the first step that differs, and how; None if all agree.

    Args:
        recorded: the part of the recording.
        again: the same part of the repetition; it has fewer steps if the episode ended early.
    """
    count = min(len(recorded.rewards), len(again.rewards))
    differing = unequal(recorded.rewards[:count], again.rewards[:count])
    if differing.size:
        step = int(differing[0])
        expected, got = (outcomes.rewards[step].item() for outcomes in (recorded, again))
        return step, f"the reward: expected {expected!r}, got {got!r}"
    if count < len(recorded.rewards):
        return (
            count - 1,
            f"terminal: expected {len(recorded.rewards) - count} more steps, got {again.terminal}",
        )
    if recorded.terminal is not None and recorded.terminal is not again.terminal:
        return count - 1, f"terminal: expected {recorded.terminal}, got {again.terminal}"
    return None


def unequal(old: npt.NDArray[Any], new: npt.NDArray[Any]) -> npt.NDArray[np.intp]:
    """Return the indices at which the bits of two arrays of numbers, of the same type and shape, differ."""
    bits = f"u{old.itemsize}"
    return np.flatnonzero(old.view(bits) != new.view(bits))
