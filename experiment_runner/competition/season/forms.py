"""The board of a season for the terminal and for a bundle; grades for the systems that teachers use."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Final

from experiment_runner.competition.board.forms import LATE, as_json, csv_text, laid_out, line_of, number
from experiment_runner.competition.board.standings import Standings, standings
from experiment_runner.competition.course import Course
from experiment_runner.competition.records.journal import utc_now
from experiment_runner.competition.records.seal import check_seal
from experiment_runner.competition.season.board import ORGANISER, SeasonBoard, season_board
from experiment_runner.report.tables import format_table
from experiment_runner.store.results import Results
from experiment_runner.store.run_data import finite
from glue.console import one_line

_LEGEND: Final = (
    "score     of the attempts that count: sum of the tasks' mean scores, with its 95 % bootstrap interval",
    "as        the best place from which a paired randomisation test over the levels does not separate it",
)


def as_text(board: SeasonBoard, width: int | None = None) -> str:
    """Return the board for the terminal.

    Args:
        board: the board.
        width: of the terminal in characters, None for no limit.
    """
    late = ["late"] if any(not math.isnan(row.late) for row in board.entrants) else []
    header = ("place", "entrant", "score", "95 % interval", "as", *board.tasks, *late, "attempts")
    rows = [
        (
            str(row.place),
            one_line(row.shown),
            number(row.score),
            f"{number(row.low)} .. {number(row.high)}",
            "" if row.like is None else str(row.like),
            *(number(row.tasks[task]) for task in board.tasks),
            *("" if math.isnan(row.late) else f"{row.late:.1%}" for _ in late),
            ", ".join(f"{count} {state}" for state, count in row.counts.items()),
        )
        for row in board.entrants
        if row.place is not None
    ]
    title = f"{board.competition}: {board.phase}, {board.opens} to {board.closes}"
    notes = [f"no place: {row.shown}: {row.missing}" for row in board.entrants if row.missing]
    notes += [
        f"forfeited: {row.shown}, attempt {one.number}, {lost.task}, trial {lost.trial}: {lost.reason}"
        for row in board.entrants
        for one in row.attempts
        for lost in one.forfeits
    ]
    notes += [f"{time}: {text}" for time, text in board.announcements]
    notes += [line_of(one) for one in board.acts]
    table = format_table(header, rows, width=width) if rows else ""
    return laid_out(title, table, notes, [*_LEGEND, *([LATE] if late else [])])


def boards_as_json(results: Results, course: Course) -> str:
    """Return the boards in a bundle, each if there is one: that of the season, for its organiser, at the time
    of the last act, and the standings of the testing tasks.

    Raises:
        ExperimentError: the run cannot be read, or was changed since it was sealed.
    """
    found: dict[str, SeasonBoard | Standings] = {}
    if course.competition.season is not None and course.acts:
        found["season"] = season_board(results, course, course.acts[-1].when, ORGANISER)
    if course.competition.testing:
        found["standings"] = standings(results, course)
    return as_json(found)


Grades = Sequence[tuple[str, float]]
"""Names and scores; NaN for one who has none."""


def _canvas(title: str, grades: Grades) -> str:
    header = ["Student", "ID", "SIS User ID", "SIS Login ID", "Section", title]
    return csv_text(header, ([name, "", "", name, "", finite(score)] for name, score in grades))


def _moodle(title: str, grades: Grades) -> str:
    return csv_text(["username", title], ([name, finite(score)] for name, score in grades))


def places_of(title: str, grades: Grades) -> str:
    """Return scores with their places, the best first, as CSV."""
    ordered = sorted(grades, key=lambda one: (math.isnan(one[1]), -one[1], one[0]))
    places = [1 + sum(other > score for _, other in grades) for _, score in ordered]
    return csv_text(
        ["place", "entrant", title],
        (
            [None if math.isnan(score) else place, name, finite(score)]
            for place, (name, score) in zip(places, ordered, strict=True)
        ),
    )


GRADES: Final[dict[str, Callable[[str, Grades], str]]] = {
    "canvas": _canvas,
    "moodle": _moodle,
    "csv": places_of,
}
"""The forms of grades by name: a file from a title and the grades."""


def grades_of(results: Results, course: Course) -> Grades:
    """Return the totals of the standings if there are any, and else the scores of the season.

    Raises:
        ExperimentError: the run cannot be read, or was changed since it was sealed.
    """
    if course.competition.testing and not course.in_season:
        return [(one.name, one.total) for one in standings(results, course).entrants]
    check_seal(results)
    return scores_of(season_board(results, course, utc_now(), ORGANISER))


def scores_of(board: SeasonBoard) -> Grades:
    """Return the scores on the board of a season for its organiser."""
    return [(row.name, row.score) for row in board.entrants]
