"""What every measurement shares: repeats, medians, tables."""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from dataclasses import dataclass

__all__ = ["REPEATS", "Table", "count", "interleaved", "ratio"]

REPEATS = 5


@dataclass(frozen=True, slots=True)
class Table:
    """A table of docs/performance.md.

    Args:
        title: a heading.
        about: a sentence or two above the table.
        columns: heads of the columns.
        rows: cells, as texts.
    """

    title: str
    about: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]

    def __str__(self) -> str:
        lines = [f"## {self.title}", "", self.about, ""]
        lines.append("| " + " | ".join(self.columns) + " |")
        lines.append("| --- |" + " ---: |" * (len(self.columns) - 1))
        lines += ["| " + " | ".join(row) + " |" for row in self.rows]
        return "\n".join(lines) + "\n"


def interleaved(measures: Sequence[Callable[[], float]], repeats: int = REPEATS) -> list[float]:
    """Return the median of each measure, all of them repeated in turn.

    In turn, so that whatever else the machine does falls on all alike, and their ratios hold.
    """
    results: list[list[float]] = [[] for _ in measures]
    for _ in range(repeats):
        for measure, values in zip(measures, results, strict=True):
            values.append(measure())
    return [statistics.median(values) for values in results]


def count(value: float) -> str:
    """Return a number to three significant digits, with thousands marked."""
    if value >= 100:
        digits = len(str(int(value))) - 3
        return f"{round(value / 10**digits) * 10**digits:,}"
    return f"{value:.3g}"


def ratio(value: float) -> str:
    """Return a ratio to two decimals."""
    return f"{value:.2f}"
