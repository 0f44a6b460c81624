"""The acts of a season's organiser, and of one who holds a competition at once."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import replace
from datetime import datetime
from pathlib import Path
from typing import Any

from experiment_runner.competition.board.forms import line_of
from experiment_runner.competition.course import Course
from experiment_runner.competition.organiser import Held, admissions
from experiment_runner.competition.records import journal
from experiment_runner.competition.records.journal import EVERYBODY, Act, act, utc_now
from experiment_runner.competition.season.control import Door, Organise, Reply, Request
from experiment_runner.competition.settings import load_competition
from experiment_runner.plan.limits import TrialId
from glue.errors import ExperimentError


def acts_for(wanted: Organise, course: Course, over: Collection[str], now: datetime) -> list[Act]:
    """Return the acts of the journal that carry out an organiser's wish.

    Args:
        wanted: the wish.
        course: of the competition, so far.
        over: ids of the trials that are over.
        now: the time.

    Raises:
        ExperimentError: it cannot be; the message says why.
    """
    state, name = course.state, wanted.subject

    def one(subject: str, kind: str = wanted.act, number: int = 0, **more: Any) -> Act:
        return act(kind, subject, wanted.why, now=now, number=number, **more)

    match wanted.act:
        case journal.ADD:
            aliases = {one.alias for one in course.acts if one.alias}
            new = wanted.admitted
            if any(each.name in course.entrants or alias in aliases for each, alias in new):
                raise ExperimentError("who takes part has changed meanwhile: try again")
            return [one(each.name, player=each.player, id=each.id, alias=alias) for each, alias in new]
        case journal.RERUN if not course.in_season:
            return [one(trial, trial=again) for trial, again in _repetitions(wanted, course, over)]
        case journal.EXCLUDE:
            if name not in state.entrants:
                raise ExperimentError(f"there is no entrant {name}; there are {', '.join(state.entrants)}")
            ends = {"waiting": journal.CANCEL, "playing": journal.OURS}
            current = state.taking_part(name).current.values()
            return [one(name), *(one(name, ends[each.state], each.number) for each in current)]
        case journal.READMIT:
            if name not in course.excluded:
                raise ExperimentError(f"{name:.80} is not excluded")
            return [one(name)]
        case journal.ANNOUNCE:
            return [one(EVERYBODY)]
        case journal.PAUSE | journal.RESUME:
            paused = state.entrant(name).paused if name not in ("", EVERYBODY) else state.paused
            if wanted.act == journal.RESUME and not paused:
                raise ExperimentError(
                    f"{name or ('the season' if course.in_season else 'the run')} is not paused"
                )
            return [one(name or EVERYBODY)]
    if state.rules is None:
        raise ExperimentError(
            f"{wanted.act:.20} is an act of a season, and the competition's file has no table [season]"
            + ("; rerun has an entrant play again" if wanted.act == journal.GRANT else "")
        )
    if state.closed is not None:
        raise ExperimentError(f"the season was closed at {state.closed}")
    match wanted.act:
        case journal.RERUN:
            attempts = state.taking_part(name).attempts
            ended = [number for number, each in attempts.items() if each.state in ("over", "ours")]
            number = wanted.number or max(ended, default=0)
            if number not in ended:
                raise ExperimentError(
                    f"{name} has no attempt {number or ''} that is over"
                    + (f"; there are {', '.join(map(str, ended))}" if ended else "")
                )
            return [one(name, number=len(attempts) + 1, instead=number)]
        case journal.GRANT:
            state.entrant(name)
            if not 1 <= wanted.number <= 10_000:
                raise ExperimentError(f"grant from 1 to 10,000 attempts, not {wanted.number}")
            return [one(name, number=wanted.number)]
        case journal.FREEZE | journal.THAW:
            if (state.frozen_at(now) is not None) == (wanted.act == journal.FREEZE):
                raise ExperimentError(f"the board is{' not' if wanted.act == journal.THAW else ''} frozen")
            return [one(EVERYBODY)]
        case journal.CLOSE:
            waiting = state.attempts("waiting")
            cancelled = (one(each.entrant, journal.CANCEL, each.number) for each in waiting)
            return [*cancelled, one(EVERYBODY)]
    raise ExperimentError(f"there is no act {wanted.act!r:.80}")


def _repetitions(wanted: Organise, course: Course, over: Collection[str]) -> Iterator[tuple[str, str]]:
    """Yield the trials of a competition that are to be played again, each with the id of its repetition."""
    name, counting = wanted.subject, course.counting
    trials = [trial for trial, last in counting.items() if trial.parts[0] == name and last in over]
    if "/" in name:
        trials, last = [TrialId(name)], counting.get(TrialId(name))
        if last is None:
            such = next(iter(counting), "alice/easy/0")
            raise ExperimentError(f"there is no trial {name}: give entrant, task and number, as in {such}")
        if last not in over:
            raise ExperimentError(f"{name} is not over: glue-compete run plays it anyway")
    elif not trials or wanted.number:
        raise ExperimentError(f"no trial of {name:.80} is over; give its name, or entrant, task and number")
    repeated = Counter(one.parts[:2] for one in course.reruns)
    for trial in trials:
        entrant, task, _ = trial.parts
        number = course.competition.trials + repeated[entrant, task]
        repeated[entrant, task] += 1
        yield trial, TrialId.of(entrant, task, number)


def answering(door: Door) -> Callable[[Held, float], None]:
    """Return the `visit` of a competition that is held at once, which carries out its organiser's acts."""

    def visit(held: Held, seconds: float) -> None:
        def answer(request: Request) -> Reply:
            if not isinstance(request, Organise):
                raise ExperimentError("the season is over, and its final is played")
            acts = acts_for(request, held.course, held.over, utc_now())
            held.record(acts, [entrant for entrant, _ in request.admitted])
            return {"acts": [line_of(one) for one in acts]}

        door.serve(answer, seconds)

    return visit


def addition(course: Course, file: Path, secret: bytes) -> Mapping[str, Any]:
    """Return the fields of an `Organise` that adds the entrants of a file, once each can be started.

    It may have to wait for a container engine, so it is not for the process that plays matches.

    Args:
        course: of the competition.
        file: describes a competition with these entrants, and those that take part.
        secret: determines their pseudonyms.

    Raises:
        ConfigError: the file cannot be read or describes no competition, or an entrant cannot be started.
        ExperimentError: it has no new entrant.
    """
    given = load_competition(file.absolute())
    new = [entrant for entrant in given.entrants if entrant.name not in course.entrants]
    if not new:
        raise ExperimentError(f"{file} has no entrant that does not take part already")
    taken = (one.alias for one in course.acts)
    acts = admissions(course.competition, new, journal.ADD, "", secret, taken)
    pairs = zip(new, acts, strict=True)
    return {"admitted": tuple((replace(entrant, id=one.id), one.alias) for entrant, one in pairs)}
