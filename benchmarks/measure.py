"""The common parts of all measurements: repeats, medians, CPU time, tables."""

from __future__ import annotations

import os
import statistics
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, TypeVar

REPEATS = 5
_TICKS = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True, slots=True)
class Picture:
    """A picture below a table of docs/performance.md.

    Args:
        file: its name in docs/images.
        about: what it shows, for those who cannot see it.
        draw: draws it into a file.
    """

    file: str
    about: str
    draw: Callable[[Path], None]


@dataclass(frozen=True, slots=True)
class Table:
    """A table of docs/performance.md.

    Args:
        title: a heading.
        about: a sentence or two above the table.
        columns: heads of the columns.
        rows: cells, as texts.
        picture: drawn from the same measurements.
    """

    title: str
    about: str
    columns: Sequence[str]
    rows: Sequence[Sequence[str]]
    picture: Picture | None = None

    def text(self, source: str) -> str:
        """Return the table in Markdown; `source` says how it was measured."""
        lines = [f"## {self.title}", "", f"{self.about} {source}", ""]
        lines.append("| " + " | ".join(self.columns) + " |")
        lines.append("| --- |" + " ---: |" * (len(self.columns) - 1))
        lines += ["| " + " | ".join(row) + " |" for row in self.rows]
        if self.picture is not None:
            lines += ["", f"![{self.picture.about}](images/{self.picture.file})"]
        return "\n".join(lines) + "\n"


class Rate(NamedTuple):
    """A rate: items `per_second`, and `cpu`, the CPU time of all processes for an item in microseconds."""

    per_second: float
    cpu: float


def rate(work: Callable[[], object], number: int, pids: Collection[int] = ()) -> Rate:
    """Return the rate at which `work`, done by this process and by `pids`, handles `number` items."""
    pids = {os.getpid(), *pids}
    used, began = _cpu_seconds(pids), time.perf_counter()
    work()
    took = time.perf_counter() - began
    return Rate(number / took, (_cpu_seconds(pids) - used) / number * 1e6)


_T = TypeVar("_T")


def interleaved(measures: Sequence[Callable[[], _T]], repeats: int = REPEATS) -> list[list[_T]]:
    """Return the results of each measure, all of them repeated in turn.

    In turn, so that other work on the machine affects all alike, and their ratios hold.
    """
    results: list[list[_T]] = [[] for _ in measures]
    for _ in range(repeats):
        for measure, values in zip(measures, results, strict=True):
            values.append(measure())
    return results


def medians(measures: Sequence[Callable[[], float]], repeats: int = REPEATS) -> list[float]:
    """Return the median of each measure, all of them repeated in turn."""
    return [statistics.median(values) for values in interleaved(measures, repeats)]


def rates(measures: Sequence[Callable[[], Rate]], repeats: int = REPEATS) -> list[Rate]:
    """Return the median rate, and the median CPU time, of each measure, all of them repeated in turn."""
    return [
        Rate(*(statistics.median(column) for column in zip(*values, strict=True)))
        for values in interleaved(measures, repeats)
    ]


def count(value: float) -> str:
    """Return a number to three significant digits, with thousands marked."""
    if value >= 100:
        digits = len(str(int(value))) - 3
        return f"{round(value / 10**digits) * 10**digits:,}"
    return f"{value:.3g}"


def ratio(value: float) -> str:
    """Return a ratio to two decimals."""
    return f"{value:.2f}"


def _cpu_seconds(pids: Collection[int]) -> float:
    """Return the CPU time that processes have used, all of their threads together."""
    ticks = 0
    for pid in pids:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        ticks += int(fields[11]) + int(fields[12])
    return ticks / _TICKS
