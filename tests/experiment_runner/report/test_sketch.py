"""Learning curves in the terminal."""

from __future__ import annotations

import numpy as np
import pytest

from experiment_runner.report.sketch import sketches
from glue.errors import ExperimentError


def test_a_curve_rises_from_its_lowest_to_its_highest_mean() -> None:
    returns = np.repeat(np.arange(40.0), 10)[np.newaxis]
    title, *rows, axis = sketches({("", "mine"): returns}, 1, "return", 46).splitlines()
    assert title == "mine: return, running mean of 1 episode"
    assert rows[0].startswith("39.0 |")
    assert rows[-1].startswith(" 0.0 |▁")
    heights = [sum(row[column : column + 1] not in ("", " ") for row in rows) for column in range(6, 46)]
    assert heights == sorted(heights)
    assert (heights[0], heights[-1]) == (1, len(rows))
    assert axis.endswith("episode 400")


def test_no_line_is_wider_than_the_terminal_and_trials_are_averaged() -> None:
    returns = np.array([[0.0] * 500, [2.0] * 500])
    shown = sketches({("", "two"): returns, ("", "short"): returns[:, :3]}, 100, "return", 60).splitlines()
    assert max(map(len, shown)) <= 60
    assert shown[1].startswith("1.0 |")
    assert not any("short" in line for line in shown)


def test_curves_of_an_environment_share_one_scale() -> None:
    low, high = (np.full((1, 20), value) for value in (1.0, 9.0))
    curves = {("here", "low"): low, ("here", "high"): high, ("there", "low"): 100 * low}
    first, second, third = (text.splitlines() for text in sketches(curves, 1, "return", 40).split("\n\n"))
    assert third[0].startswith("low, there: return")
    assert third[1].startswith("100.0 |")
    assert [row[:5] for row in first[1:-1]] == [row[:5] for row in second[1:-1]]
    assert "█" not in "".join(first)
    assert second[1].endswith("█" * 20)


def test_nothing_to_show_is_an_error() -> None:
    with pytest.raises(ExperimentError, match="nothing"):
        sketches({}, 100, "return", 80)
