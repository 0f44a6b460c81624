"""Which attempts play next, who may ask for one, and when: pure functions of a season's state and the time.

Entrants take turns: who was let play longest ago is next, with its oldest attempt that waits. Each plays one
attempt at a time. So a thousand attempts of one entrant delay those of another by one.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime, time, timedelta
from typing import Final

from experiment_runner.competition.records.journal import REQUEST, Act, act
from experiment_runner.competition.season.control import TryLater
from experiment_runner.competition.state import Attempt, Enrolled, State
from glue.errors import ExperimentError

_MOST_LEFT: Final = 100
"""Attempts of an entrant in a day that it may leave while they wait: they cost nothing, and are kept."""


def queue(state: State) -> list[Attempt]:
    """Return the attempts that wait and may be let play, in the order in which they will be if none is added.

    An attempt's place in the queue is its place in this list.
    """
    turns = [
        ((turn, entrant.served, one.order), one)
        for entrant in state.entrants.values()
        if not (entrant.excluded or entrant.paused)
        for turn, one in enumerate(entrant.waiting)
    ]
    return [one for _, one in sorted(turns, key=lambda turn: turn[0])]


def next_attempts(
    state: State, now: datetime, ready: Callable[[Attempt], bool] = lambda one: True
) -> list[Attempt]:
    """Return the attempts that are to be let play now, in this order; none while the season is paused.

    Args:
        state: the season.
        now: the time.
        ready: whether an attempt can play; others are passed over.
    """
    if state.paused or now < state.season.opens:
        return []
    playing = {one.entrant for one in state.attempts("playing")}
    chosen: dict[str, Attempt] = {}
    for one in queue(state):
        if one.entrant not in playing and ready(one):
            chosen.setdefault(one.entrant, one)
    return list(chosen.values())[: max(0, state.season.parallel - len(playing))]


def left(state: State, entrant: Enrolled, now: datetime) -> int:
    """Return the number of attempts that an entrant can still ask for today."""
    today = now.astimezone(state.season.days).date()
    return max(0, state.season.attempts_per_day - entrant.used[today]) + entrant.granted


def returns_at(state: State, now: datetime) -> datetime | None:
    """Return when attempts are charged to the next day; None if the season closes before."""
    midnight = day_after(state, now)
    return midnight if midnight < state.season.closes else None


def day_after(state: State, when: datetime) -> datetime:
    """Return when the day after that of a time begins, in the time zone of the season."""
    day = when.astimezone(state.season.days).date() + timedelta(days=1)
    return datetime.combine(day, time(), state.season.days)


def check_not_over(state: State, now: datetime) -> None:
    """Check that entrants can still ask for something.

    Raises:
        ExperimentError: the season is over.
    """
    if state.closed is not None or now >= state.season.closes:
        raise ExperimentError(f"the season closed at {state.closed or state.season.closes}")


def request(state: State, name: str, now: datetime) -> Act:
    """Return the act of queueing an entrant's next attempt.

    Raises:
        TryLater: it has used its attempts of today.
        ExperimentError: there is no such entrant, or it cannot ask for one now; the message says why.
    """
    check_not_over(state, now)
    entrant, season = state.taking_part(name), state.season
    if now < season.opens:
        raise ExperimentError(f"the season opens at {season.opens}")
    if entrant.paused:
        raise ExperimentError(f"{name} is paused: {entrant.paused}")
    if len(entrant.waiting) >= season.most_waiting:
        raise ExperimentError(f"{season.most_waiting} attempts of {name} wait already")
    today = now.astimezone(season.days).date()
    gone = (one for one in entrant.attempts.values() if one.state == "cancelled")
    if sum(one.requested.astimezone(season.days).date() == today for one in gone) >= _MOST_LEFT:
        raise ExperimentError(f"{name} has left {_MOST_LEFT} attempts of today while they waited: no more")
    if left(state, entrant, now) < 1:
        used = f"{name} has used its {season.attempts_per_day} attempts of today"
        if (again := returns_at(state, now)) is None:
            raise ExperimentError(used)
        raise TryLater(f"{used}; the next day begins at {again}", (again - now).total_seconds())
    return act(REQUEST, name, "", now=now, number=len(entrant.attempts) + 1)
