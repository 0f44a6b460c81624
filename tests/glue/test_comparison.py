"""The comparison that replays of all recordings share."""

from __future__ import annotations

import math

import numpy as np
import pytest

from glue.trajectory.comparison import Outcomes, compare

RECORDED = Outcomes(np.array([1.0, 0.0, math.nan]), True)


@pytest.mark.parametrize(
    ("rewards", "terminal", "step"),
    [
        ([1.0, 0.0, math.nan], True, None),
        ([1.0, -0.0, math.nan], True, 1),
        ([1.0, 0.0, 2.0], True, 2),
        ([1.0, 0.0, math.nan], False, 2),
        ([1.0, 0.0], True, 1),
        ([], False, -1),
    ],
)
def test_the_first_step_that_differs_is_found(rewards: list[float], terminal: bool, step: int | None) -> None:
    found = compare(RECORDED, Outcomes(np.array(rewards, np.float64), terminal))
    assert (found and found[0]) == step


@pytest.mark.parametrize("terminal", [False, True])
def test_an_end_that_the_recording_leaves_open_is_not_compared(terminal: bool) -> None:
    assert compare(RECORDED._replace(terminal=None), RECORDED._replace(terminal=terminal)) is None
