"""The standings for the terminal, as CSV and as JSON."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from itertools import chain
from typing import Final

import msgspec

from experiment_runner.competition.board.standings import Standings
from experiment_runner.competition.records.journal import ADD, EXCLUDE, RERUN, Act
from experiment_runner.report.tables import format_table
from experiment_runner.store.run_data import csv_row
from glue.console import one_line

LEGEND: Final = (
    "place     by the mean of the ranks in the tasks; those who are equal share it",
    "total     sum of the tasks' scores, with its 95 % bootstrap interval over trials, and the place by it",
    "score     of a task: the sum of all rewards, learning included, mean over trials; a forfeited trial "
    "scores what an agent that stands still earns, or the lowest verified score if that is lower",
)
LATE: Final = "late      share of the actions that came too late for their step, in tasks with a rate"
"""Line of the legend for boards with a column `late`."""


def number(value: float) -> str:
    """Return a score as text."""
    return f"{value:,.2f}"


def line_of(one: Act) -> str:
    """Return an act of the organiser as one line."""
    did = {ADD: "added", EXCLUDE: "excluded", RERUN: "played again"}.get(one.act, one.act)
    return f"{did}: {one_line(one.subject)}, {one_line(one.time)}: {one_line(one.reason)}"


def as_text(board: Standings, width: int | None = None) -> str:
    """Return the standings for the terminal.

    Args:
        board: the standings.
        width: of the terminal in characters, None for no limit.
    """
    late = ["late"] if _timed(board) else []
    header = ("place", "entrant", "mean rank", "total", "95 % interval", "by total", *board.tasks, *late)
    rows = [
        (
            str(one.place),
            one.name,
            f"{one.mean_rank:g}",
            number(one.total),
            f"{number(one.low)} .. {number(one.high)}",
            str(one.place_by_total),
            *(number(one.tasks[task].score) for task in board.tasks),
            *(f"{one.late:.1%}" for _ in late),
        )
        for one in board.entrants
        if one.place is not None
    ]
    notes = [f"no place: {other.name}: {other.missing}" for other in board.entrants if other.missing]
    notes += [
        f"forfeited: {standing.name}, {forfeit.task}, trial {forfeit.trial}: {forfeit.reason}"
        for standing in board.entrants
        for forfeit in standing.forfeits
    ]
    notes += [line_of(one) for one in board.acts]
    notes += [f"{one.name} is {one.player}, {one.id}" for one in board.entrants if one.id]
    table = format_table(header, rows, width=width) if rows else ""
    text = laid_out(board.competition, table, notes, [*LEGEND, *([LATE] if late else [])])
    parts = [text, one_line(board.program)]
    if board.seeds:
        seeds = [
            (seed.task, str(seed.trial), str(seed.seed), json.dumps(seed.options)) for seed in board.seeds
        ]
        parts.append(format_table(("task", "trial", "seed", "options"), seeds, prose=True))
    return "\n\n".join(parts)


def laid_out(title: str, table: str, notes: Iterable[str], legend: Iterable[str]) -> str:
    """Return a board for the terminal; without a place for anybody, its table is empty."""
    parts = (one_line(title), table, "\n".join(map(one_line, notes)), "\n".join(legend))
    return "\n\n".join(filter(None, parts))


def as_csv(board: Standings) -> str:
    """Return the standings as CSV: one line for each entrant."""
    timed = ["late"] if _timed(board) else []
    numbers = ["mean_rank", "place_by_total", "total", "low", "high"]
    numbers += [f"{what} {task}" for task in board.tasks for what in ("score", "rank")] + timed
    texts = ["forfeits", "no_place", "player", "id", "program", *(["seeds"] if board.seeds else [])]
    seeds = [json.dumps([asdict(seed) for seed in board.seeds])] if board.seeds else []
    rows: list[list[object]] = []
    for one in board.entrants:
        found: list[object] = [""] * len(numbers)
        if one.place is not None:
            scores = [(one.tasks[task].score, one.tasks[task].rank) for task in board.tasks]
            found = [one.mean_rank, one.place_by_total, one.total, one.low, one.high]
            found += [*chain(*scores), *([one.late] if timed else [])]
        forfeits = "; ".join(f"{lost.task}/{lost.trial}: {lost.reason}" for lost in one.forfeits)
        told = (forfeits, one.missing, one.player, one.id, board.program)
        rows.append([one.place, one.name, *found, *told, *seeds])
    return csv_text(["place", "entrant", *numbers, *texts], rows)


def csv_text(header: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table as CSV."""
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(map(csv_row, (header, *rows)))
    return text.getvalue()


def as_json(board: object) -> str:
    """Return a board, or boards by name, as a JSON object; a missing number is null."""
    return json.dumps(json.loads(msgspec.json.encode(board)), indent=2) + "\n"


def _timed(board: Standings) -> bool:
    """Return whether an entrant with a place has played a task with a rate."""
    return any(not math.isnan(one.late) for one in board.entrants if one.place is not None)
