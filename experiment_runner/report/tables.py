"""Plain-text tables, and the table and summary that `glue-experiment` ends with."""

from __future__ import annotations

import shutil
import sys
import textwrap
from collections.abc import Iterable, Sequence
from typing import Final

from experiment_runner.store.records import Totals, TrialRecord
from experiment_runner.store.results import Results
from glue.console import one_line

_LAST: Final = 100
_COLUMNS: Final = ("trial", "episodes", "steps", "mean return", f"mean of last {_LAST}", "cut off", "void")
_GAP: Final = "  "
_INEXACT: Final = 1e15  # from here on a double has no second decimal place
_LEAST_PROSE: Final = 30  # minimum width of a wrapped column, in characters


def terminal_width() -> int | None:
    """Return the width of the terminal in characters; None if standard output is not a terminal."""
    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


def counted(number: int, thing: str) -> str:
    """Return a number and its noun, as in `1 trial` and `2 trials`."""
    return f"{number:,} {thing}" if number == 1 else f"{number:,} {thing}s"


def decimal(value: float) -> str:
    """Return a number with two decimal places, or with an exponent if it is too large for them."""
    return f"{value:.2f}" if abs(value) < _INEXACT else f"{value:g}"


def unfinished(trials: Iterable[TrialRecord], where: str = "") -> list[str]:
    """Return a line about the trials that have failed, and one about others that are not finished."""
    left = [trial for trial in trials if not trial.finished]
    failed = sum(trial.failure is not None for trial in left)
    lines = [f"{counted(failed, 'failed trial')}{where} left out"] if failed else []
    if len(left) > failed:
        lines.append(f"{counted(len(left) - failed, 'trial')}{where} not finished")
    return lines


def format_table(
    header: Sequence[str], rows: Sequence[Sequence[str]], *, width: int | None = None, prose: bool = False
) -> str:
    """Return a table with a header line; the first column is aligned left, the others right.

    Args:
        header: the names of the columns.
        rows: the cells, one for each column.
        width: maximum length of a line, None for no limit. A wider table becomes a paragraph for each row,
            with a line for each column, so that no word is broken.
        prose: whether the last column is text, which is aligned left and may be wrapped.
    """
    cells = [[one_line(cell) for cell in row] for row in (header, *rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    if width is not None and sum(widths) + len(_GAP) * (len(widths) - 1) > width:
        room = width - sum(widths[:-1]) - len(_GAP) * (len(widths) - 1)
        if not prose or room < _LEAST_PROSE:
            return "\n\n".join(_paragraph(cells[0], row, width) for row in cells[1:])
        widths[-1] = room
    return "\n".join(_line(row, widths, prose) for row in cells)


def markdown_table(head: Sequence[str], rows: Sequence[Sequence[str]], texts: int) -> str:
    """Return a table whose first `texts` columns are aligned left, and the others right."""
    lines = [f"| {' | '.join(cells)} |" for cells in (head, *rows)]
    lines.insert(1, f"|{' --- |' * texts}{' ---: |' * (len(head) - texts)}")
    return "\n".join(lines)


def _line(row: Sequence[str], widths: Sequence[int], prose: bool) -> str:
    numbers = row[1:-1] if prose else row[1:]
    parts = [row[0].ljust(widths[0])]
    parts += [cell.rjust(width) for cell, width in zip(numbers, widths[1:], strict=False)]
    if prose:
        indent = sum(widths[:-1]) + len(_GAP) * (len(widths) - 1)
        parts.append(wrap(row[-1], widths[-1]).replace("\n", "\n" + " " * indent))
    return _GAP.join(parts).rstrip()


def _paragraph(header: Sequence[str], row: Sequence[str], width: int) -> str:
    name = max(map(len, header[1:]), default=0)
    lines = [row[0]]
    for label, cell in zip(header[1:], row[1:], strict=True):
        if not cell:
            continue
        indent = len(_GAP) + name + len(_GAP)
        text = wrap(cell, max(width - indent, 1)).replace("\n", "\n" + " " * indent)
        lines.append(f"{_GAP}{label.ljust(name)}{_GAP}{text}".rstrip())
    return "\n".join(lines)


def wrap(text: str, width: int | None) -> str:
    """Return a text in lines of at most `width` characters, None for no limit, broken only between words."""
    if width is None:
        return text
    return textwrap.fill(text, width, break_long_words=False, break_on_hyphens=False)


def tabulate(results: Results, seconds: float, width: int | None = None) -> str:
    """Return a table with a line for each trial, followed by the reasons for failures.

    If there is only one trial, the reason is left out: it has just been shown.
    """
    rows, failures = [], []
    trials, names = results.trials(), results.trial_names()
    for record in trials:
        totals = results.totals(record.spec.id)
        means = [_mean([part]) for part in (totals, results.totals(record.spec.id, _LAST))]
        rows.append(
            (
                names[record.spec.id],
                record.progress,
                f"{totals.steps:,}",
                *("-" if mean is None else decimal(mean) for mean in means),
                f"{totals.cut_off}",
                f"{record.voids}",
            )
        )
        if record.failure is not None and len(trials) > 1:
            failures.append(one_line(f"failed: {names[record.spec.id]}: {record.failure}"))
    lines = [format_table(_COLUMNS, rows, width=width), "", *failures]
    lines.append(f"{seconds:.1f} s; results in {one_line(str(results.directory))}")
    return "\n".join([lines[0], *(wrap(line, width) for line in lines[1:])])


def summarize(results: Results, seconds: float) -> dict[str, object]:
    """Return the object of the last line of `--json`; means are None if there are no episodes."""
    trials = results.trials()
    totals = [results.totals(trial.spec.id) for trial in trials]
    return {
        "summary": True,
        "episodes": sum(trial.episodes for trial in totals),
        "steps": sum(trial.steps for trial in totals),
        "mean_return": _mean(totals),
        f"mean_last_{_LAST}": _mean([results.totals(trial.spec.id, _LAST) for trial in trials]),
        "cut_off": sum(trial.cut_off for trial in totals),
        "voids": sum(trial.voids for trial in trials),
        "failed_trials": sum(trial.failure is not None for trial in trials),
        "seconds": seconds,
        "out": str(results.directory),
    }


def _mean(totals: Sequence[Totals]) -> float | None:
    """Return the mean return of all episodes in `totals`; None if there are none."""
    episodes = sum(trial.episodes for trial in totals)
    return sum(trial.sum_of_returns for trial in totals) / episodes if episodes else None
