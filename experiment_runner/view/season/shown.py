"""The contents of the page of a season as JSON: the board, and each entrant with its attempts."""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import UTC, datetime
from typing import Any, Final

from experiment_runner.competition.board.forms import line_of
from experiment_runner.competition.season.board import ORGANISER, PUBLIC, AttemptRow, EntrantRow, SeasonBoard
from experiment_runner.competition.season.schedule import left, returns_at
from experiment_runner.competition.settings import Competition, Season
from experiment_runner.competition.state import State
from experiment_runner.report import svg
from experiment_runner.store.run_data import finite

_MOST_LINES: Final = 7
"""Number of entrants whose places over time are drawn on the board: as many as there are colors."""

_TICK: Final = re.compile(r">-(\d+)(\.\d+)?<")
"""A number at the axis of places: there is no place between two others."""

_UNITS: Final = (("days", 86_400), ("hours", 3600), ("minutes", 60))
_LEAST_UNITS: Final = 2
"""Of the time that is drawn: the largest unit of which it has so many is that of the axis."""

_SIZES: Final = {"narrow": (480, 300), "wide": (1400, 320)}
"""Width and height of a drawing for a phone, and for other windows."""

_BYTES_OF_GIB: Final = 2**30


def board_as_json(
    board: SeasonBoard, state: State, rules: Sequence[str], viewer: str, now: datetime
) -> dict[str, Any]:
    """Return the board as JSON, without the attempts of the entrants.

    Args:
        board: for this viewer.
        state: of the season.
        rules: see `rules_of`.
        viewer: see `season_board`.
        now: the time.
    """
    mine = next((one for one in board.entrants if one.mine), None)
    began = {(one.shown, attempt.number): attempt.began for one in board.entrants for attempt in one.attempts}
    return {
        "season": board.competition,
        "state": _state(board, viewer),
        "tasks": board.tasks,
        "you": None if mine is None else mine.shown,
        "left": "" if mine is None else _left(state, viewer, now),
        "announcements": [{"time": time, "text": text} for time, text in board.announcements],
        "entrants": [_summary(one) | {"tasks": _finite(one.tasks)} for one in board.entrants],
        "playing": [
            {"name": shown, "attempt": number, "since": began.get((shown, number), "")}
            for shown, number in board.playing
        ],
        "waiting": [shown for shown, _ in board.waiting],
        "over_time": over_time(board, board.entrants[:_MOST_LINES]),
        "acts": [line_of(one) for one in board.acts],
        "rules": rules,
        "replays": True,
    }


def entrant_as_json(board: SeasonBoard, shown: str) -> dict[str, Any]:
    """Return an entrant with its attempts as JSON, the newest first.

    Raises:
        KeyError: this viewer knows no entrant of that name.
    """
    one = row_of(board, shown)
    return _summary(one) | {
        "attempts": [_attempt(attempt, board) for attempt in reversed(one.attempts)],
        "over_time": over_time(board, [one]),
    }


def row_of(board: SeasonBoard, shown: str) -> EntrantRow:
    """Return an entrant by its name on the board.

    Raises:
        KeyError: there is none.
    """
    for one in board.entrants:
        if one.shown == shown:
            return one
    raise KeyError(shown)


def over_time(board: SeasonBoard, rows: Sequence[EntrantRow]) -> dict[str, Any] | None:
    """Return the places of entrants over time as a narrow and a wide drawing, the first place on top; None
    without any."""
    rows = [one for one in rows if any(place is not None for place in one.places)]
    if not rows or len(board.times) < 2:
        return None
    moments = [datetime.fromisoformat(time).timestamp() for time in board.times]
    unit, seconds = next(
        one for one in _UNITS if moments[-1] - moments[0] >= one[1] * _LEAST_UNITS or one is _UNITS[-1]
    )
    at = [(moment - moments[0]) / seconds for moment in moments]
    lines = [
        # Places count down, and the axis up: its numbers are negative, and drawn as they are meant.
        svg.Line(at, [None if place is None else -float(place) for place in one.places])
        for one in rows
    ]
    return {
        **{name: _drawn(lines, unit, size) for name, size in _SIZES.items()},
        "legend": [{"name": one.shown, "sample": svg.sample(number)} for number, one in enumerate(rows)],
    }


def _drawn(lines: Sequence[svg.Line], unit: str, size: tuple[int, int]) -> str:
    drawn: str = svg.draw(lines, (unit, "place"), size)["svg"]
    return _TICK.sub(lambda tick: "><" if tick[2] else f">{tick[1]}<", drawn)


def rules_of(competition: Competition, season: Season) -> list[str]:
    """Return the rules and limits of a season, as sentences."""
    limits, day = competition.limits, f"a day ({season.zone})"
    times = "once" if competition.trials == 1 else f"{competition.trials} times"
    which = {"best": "best attempt", "last": "last attempt", "mean": "mean of all attempts"}[season.count]
    rules = [
        f"Attempts: {season.attempts_per_day} {day}; one at a time for each entrant, {season.parallel} at "
        f"once in all, in turn. At most {season.most_waiting} of an entrant wait.",
        f"Each attempt plays each task {times}. An entrant's {which} counts.",
        f"Time: {limits.step_seconds:g} s for an answer; what takes longer is drawn from a bank of "
        f"{limits.bank_seconds:g} s for a trial. {limits.start_seconds:g} s to connect, "
        f"{limits.total_seconds:g} s for all answers of a trial.",
        "An attempt that fails for a reason that is not the entrant's costs none, and is played again.",
        f"An entrant that forfeits {season.failures} attempts in a row is paused until the next day"
        + (", with an image until it submits another." if season.images else "."),
        "Every score was verified: its actions were played again, and paid the same rewards.",
        f"At most {season.most_entrants:,} entrants"
        + (f", and {season.most_bytes / _BYTES_OF_GIB:.3g} GiB for an image." if season.images else ".")
        + " Too many requests are answered with 429 or 503, and with the seconds to wait before the next.",
    ]
    if any(task.hidden for task in competition.proving):
        rules.append("Scores of tasks with hidden levels are told when the season is closed.")
    return rules


def _left(state: State, name: str, now: datetime) -> str:
    """Return how many attempts an entrant has left, and when more come."""
    number, more = left(state, state.entrants[name], now), returns_at(state, now)
    when = "" if more is None else f"; a new day begins at {_minute(more.astimezone(UTC).isoformat())}"
    return f"You have {number} attempt{'' if number == 1 else 's'} left{when}."


def _state(board: SeasonBoard, viewer: str) -> str:
    words = {
        "before": f"opens at {_minute(board.opens)}",
        "open": f"open until {_minute(board.closes)}",
        "over": f"over since {_minute(board.closes)}; what waits is still played",
        "closed": "closed",
    }
    parts = [words[board.phase]]
    if board.frozen:
        parts.append(
            f"frozen for others since {_minute(board.frozen)}"
            if viewer != PUBLIC
            else f"as it was at {_minute(board.frozen)}: the board is frozen"
        )
    if board.paused:
        parts.append(f"paused: {board.paused}")
    if viewer == ORGANISER:
        parts.append("you see what the organiser sees")
    return "; ".join(parts)


def _minute(time: str) -> str:
    return f"{datetime.fromisoformat(time):%Y-%m-%d %H:%M} UTC"


def _summary(one: EntrantRow) -> dict[str, Any]:
    return {
        "name": one.shown,
        "own": one.name if one.name != one.shown else "",
        "team": one.team,
        "place": one.place,
        "score": finite(one.score),
        "low": finite(one.low),
        "high": finite(one.high),
        "tied": one.like,
        "late": finite(one.late),
        "counts": dict(one.counts),
        "counting": [attempt.number for attempt in one.attempts if attempt.counts],
        "why": "; ".join(filter(None, (one.missing, one.paused and f"paused: {one.paused}"))),
    }


def _attempt(one: AttemptRow, board: SeasonBoard) -> dict[str, Any]:
    forfeits = [f"{lost.task}, trial {lost.trial}: {lost.reason}" for lost in one.forfeits]
    notes = [f"instead of attempt {one.instead}"] if one.instead else []
    notes += ["withdrawn"] if one.withdrawn else []
    notes += [f"number {one.place} in the queue"] if one.place else []
    return {
        "attempt": one.number,
        "state": one.state,
        "score": finite(one.score),
        "tasks": _finite(one.tasks),
        "began": one.began,
        "ended": one.ended,
        "counts": one.counts,
        "why": "; ".join(dict.fromkeys([*notes, *filter(None, [one.why]), *forfeits])),
        "replay": one.state == "verified" and bool(board.tasks),
    }


def _finite(scores: Any) -> dict[str, Any]:
    return {task: finite(score) for task, score in scores.items()}
