"""The acts of a season's organiser, and of one who holds a competition at once."""

from __future__ import annotations

from collections.abc import Collection
from datetime import datetime
from pathlib import Path

from experiment_runner.competition.course import Course
from experiment_runner.competition.organiser import admissions
from experiment_runner.competition.records import journal
from experiment_runner.competition.records.journal import EVERYBODY, Act, act
from experiment_runner.competition.season.control import Organise
from experiment_runner.competition.season.state import SeasonState
from experiment_runner.competition.settings import Competition, load_competition
from glue.errors import ExperimentError


def acts_for(
    wanted: Organise,
    given: Competition | None,
    course: Course,
    state: SeasonState | None,
    over: Collection[str],
    now: datetime,
) -> list[Act]:
    """Return the acts of the journal that carry out an organiser's wish.

    Args:
        wanted: the wish.
        given: the competition of its file, see `competition_given`.
        course: of the competition, so far.
        state: of the season; None if the competition has none.
        over: ids of the trials that are over.
        now: the time.

    Raises:
        ExperimentError: it cannot be; the message says why.
    """

    def one(subject: str, kind: str = wanted.act, number: int = 0, **more: int) -> Act:
        return act(kind, subject, wanted.why, now=now, number=number, **more)

    name = wanted.subject
    match wanted.act:
        case journal.ADD:
            assert given is not None
            return _added(wanted, given, course, now)
        case journal.RERUN if "/" in name:
            return course.repetitions([name], over, wanted.why)
        case journal.EXCLUDE:
            return [course.exclusion(name, wanted.why), *_ended(state, name, wanted.why, now)]
        case journal.READMIT:
            if name not in course.excluded:
                raise ExperimentError(f"{name:.80} is not excluded")
            return [one(name)]
        case journal.ANNOUNCE:
            return [one(EVERYBODY)]
    if state is None:
        raise ExperimentError(
            f"{wanted.act:.20} is an act of a season, and the competition's file has no table [season]"
        )
    if state.closed is not None and wanted.act in (journal.RERUN, journal.CLOSE):
        raise ExperimentError(f"the season was closed at {state.closed}")
    match wanted.act:
        case journal.RERUN:
            return [_rerun(wanted, state, now)]
        case journal.GRANT:
            state.entrant(name)
            if not 1 <= wanted.number <= 10_000:
                raise ExperimentError(f"grant from 1 to 10,000 attempts, not {wanted.number}")
            return [one(name, number=wanted.number)]
        case journal.PAUSE | journal.RESUME:
            paused = state.paused if name in ("", EVERYBODY) else state.entrant(name).paused
            if wanted.act == journal.RESUME and not paused:
                raise ExperimentError(f"{name or 'the season'} is not paused")
            return [one(name or EVERYBODY)]
        case journal.FREEZE | journal.THAW:
            if (state.frozen_at(now) is not None) == (wanted.act == journal.FREEZE):
                raise ExperimentError(f"the board is{' not' if wanted.act == journal.THAW else ''} frozen")
            return [one(EVERYBODY)]
        case journal.CLOSE:
            waiting = state.attempts("waiting")
            cancelled = (one(each.entrant, journal.CANCEL, each.number) for each in waiting)
            return [*cancelled, one(EVERYBODY)]
    raise ExperimentError(f"there is no act {wanted.act!r:.80}")


def competition_given(wanted: Organise) -> Competition | None:
    """Return the competition of the file of a wish to add its entrants; None for another wish.

    Raises:
        ConfigError: the file cannot be read or describes no competition.
    """
    return load_competition(Path(wanted.file)) if wanted.act == journal.ADD else None


def _added(wanted: Organise, given: Competition, course: Course, now: datetime) -> list[Act]:
    known = course.entrants
    new = [entrant for entrant in given.entrants if entrant.name not in known]
    if not new:
        raise ExperimentError(f"{wanted.file} has no entrant that does not take part already")
    return admissions(given, new, journal.ADD, wanted.why, now)


def _ended(state: SeasonState | None, name: str, why: str, now: datetime) -> list[Act]:
    """Return the ends of the attempts of one who is excluded."""
    if state is None:
        return []
    entrant = state.entrant(name)
    return [
        act(journal.CANCEL if one.state == "waiting" else journal.OURS, name, why, now=now, number=one.number)
        for one in entrant.current.values()
    ]


def _rerun(wanted: Organise, state: SeasonState, now: datetime) -> Act:
    name, entrant = wanted.subject, state.taking_part(wanted.subject)
    ended = [number for number, one in entrant.attempts.items() if one.state in ("over", "ours")]
    number = wanted.number or max(ended, default=0)
    if number not in ended:
        raise ExperimentError(
            f"{name} has no attempt {number or ''} that is over"
            + (f"; there are {', '.join(map(str, ended))}" if ended else "")
        )
    return act(journal.RERUN, name, wanted.why, now=now, number=len(entrant.attempts) + 1, instead=number)
