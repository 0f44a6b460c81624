"""The board of a season: a function of its journal and records, for the eyes of one viewer.

Only verified attempts have a score: the sum over the tasks of the mean over their trials, each the sum of all
its rewards. A forfeited trial scores as in `experiment_runner.competition.board.standings`.
Entrants are ordered by the unrounded score of the attempts that count. An attempt that was run again is, with
everything that follows from it, as if it had been so from the start.
"""

from __future__ import annotations

import math
import re
from bisect import bisect_right
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import datetime
from functools import cached_property
from itertools import accumulate, compress
from typing import Final, NamedTuple

import numpy as np
import numpy.typing as npt

from experiment_runner.analysis.stats import FloatArray, bootstrap_rng
from experiment_runner.competition.board.standings import Forfeit, interval
from experiment_runner.competition.course import Course
from experiment_runner.competition.records import journal
from experiment_runner.competition.records.journal import EVERYBODY, Act, time_text
from experiment_runner.competition.season.schedule import queue
from experiment_runner.competition.settings import Competition
from experiment_runner.competition.state import Attempt, Enrolled
from experiment_runner.store.records import ReplayVerdict, TrialEnd
from experiment_runner.store.results import Results

PUBLIC: Final = ""
"""The viewer without a token."""

ORGANISER: Final = "*"
"""The viewer who sees everything, at once. Any other viewer is the name of an entrant."""

_OF_ALL: Final = (
    *(journal.ADD, journal.EXCLUDE, journal.READMIT, journal.RERUN),
    *(journal.FREEZE, journal.THAW, journal.CHANGE, journal.CLOSE),
)
_OF_ITS_OWNER: Final = (journal.PAUSE, journal.RESUME, journal.GRANT)
"""Acts that are shown to everybody, and those about an entrant that are shown to its owner."""

_AGENT: Final = ("agent ", "the agent ")
_DID: Final = re.compile(
    r"raised in agent_(init|start|step|end|message|cleanup)\b|was unreachable for \d+\.\d s|left\b|"
    r"ran out of time|used more than [\d.e+]+ s in all|took more than [\d.e+]+ s to initialise|"
    r"sent a malformed message"
)
"""The words of a hub between the name of an agent that has failed and the agent's own."""

_TIMES: Final = 200
_FLIPS: Final = 999
_LEVEL: Final = 0.05
_ROUNDING: Final = 1e-9


@dataclass(frozen=True, slots=True)
class AttemptRow:
    """An attempt on the board. Times are UTC, as in the journal; empty if there is none.

    Args:
        number: among its entrant's, from 1.
        state: `waiting`, `playing`, `verified`, `forfeited`, `unverified` (its replay does not match), `over`
            (during a freeze), `ours` or `cancelled`.
        requested, began, ended: times.
        score: see above, over the tasks that this viewer may know; NaN unless verified or forfeited.
        tasks: the score of each of these tasks.
        counts: whether it is among those that make its entrant's score.
        forfeits: of its trials; numbers are those of the levels, from 0. Others than the owner and the
            organiser are told the rule that ended a trial, and not the words of the entrant's program: it
            may say in them who it is, or anything else.
        place: in the queue, from 1; 0 if it does not wait.
        instead: number of the attempt that it replaces; 0 if none.
        withdrawn: whether its owner has withdrawn it.
        why: reason for its state, for its owner and the organiser; empty for others, and without one.
    """

    number: int
    state: str
    requested: str
    began: str = ""
    ended: str = ""
    score: float = math.nan
    tasks: Mapping[str, float] = field(default_factory=dict)
    counts: bool = False
    forfeits: tuple[Forfeit, ...] = ()
    place: int = 0
    instead: int = 0
    withdrawn: bool = False
    why: str = ""


@dataclass(frozen=True, slots=True)
class EntrantRow:
    """An entrant on the board.

    Args:
        shown: its pseudonym or its name, as the season shows it to this viewer.
        name: its own name; empty for those who may not know it.
        team: empty if it has none, or for those who may not know it.
        place: by the score, from 1; equal scores share it; None without a score.
        score: see above; NaN without one.
        low, high: its 95 % bootstrap interval over trials.
        tasks: score in each task.
        like: the best place above such that it is not separated from that one, nor from any in between: a
            paired randomisation test over the levels does not reject at 5 % that they are equal. None if it
            is separated from the place above. Fewer than 6 levels separate no one.
        counts: number of attempts in each state that there was.
        attempts: oldest first.
        places: its place at each of `SeasonBoard.times`; None before it had one.
        missing: why it has no place; empty if it has one.
        paused: why its attempts wait, for its owner and the organiser; empty if they need not.
        mine: whether this viewer is its owner.
        late: share of late actions in the attempts that count, in the tasks with a rate; NaN without one.
    """

    shown: str
    name: str = ""
    team: str = ""
    place: int | None = None
    score: float = math.nan
    low: float = math.nan
    high: float = math.nan
    tasks: Mapping[str, float] = field(default_factory=dict)
    like: int | None = None
    counts: Mapping[str, int] = field(default_factory=dict)
    attempts: tuple[AttemptRow, ...] = ()
    places: tuple[int | None, ...] = ()
    missing: str = ""
    paused: str = ""
    mine: bool = False
    late: float = math.nan


@dataclass(frozen=True, slots=True)
class SeasonBoard:
    """The board of a season.

    Args:
        competition: its name.
        phase: `before` it opens, `open`, `over` when no more attempts can be asked for, or `closed`.
        opens, closes: times, UTC.
        frozen: since when this board is frozen; empty if it is not.
        paused: the reason why no attempt is let play; empty if attempts are.
        count: see `Season`.
        tasks: those with scores for this viewer, in order.
        hidden: the others.
        entrants: those with a place first, by place.
        times: at which places over time are given, oldest first; at most 200.
        playing, waiting: attempts, each the entrant as shown and the number; those that wait in their order.
        announcements: each its time and text, newest first.
        acts: of the organiser that this viewer may know, newest first; entrants are named as shown.
    """

    competition: str
    phase: str
    opens: str
    closes: str
    frozen: str
    paused: str
    count: str
    tasks: tuple[str, ...]
    hidden: tuple[str, ...]
    entrants: tuple[EntrantRow, ...]
    times: tuple[str, ...]
    playing: tuple[tuple[str, int], ...]
    waiting: tuple[tuple[str, int], ...]
    announcements: tuple[tuple[str, str], ...]
    acts: tuple[Act, ...]


def season_board(results: Results, course: Course, now: datetime, viewer: str = PUBLIC) -> SeasonBoard:
    """Return the board of a season.

    The seal is not checked here, see `experiment_runner.competition.records.seal.check_seal`: it covers all
    that was ever played, and the board is looked at often.

    Args:
        results: of the run.
        course: its tasks, entrants and acts.
        now: the time.
        viewer: `PUBLIC`, `ORGANISER` or the name of an entrant.

    Raises:
        ExperimentError: the run cannot be read, or the competition has no season.
    """
    return Boards.of(results, course, now).seen_by(viewer)


class Boards:
    """The boards of a season for all viewers; what takes time is done once for the organiser, and once for
    all others.

    Args:
        course: tasks, entrants and acts, which do not change any more.
        outcomes, verdicts, late: of the trials, by id, as `Results` returns them.
        now: the time.

    Attributes:
        course: as given.

    Raises:
        ExperimentError: the competition has no season.
    """

    def __init__(
        self,
        course: Course,
        outcomes: Mapping[str, TrialEnd],
        verdicts: Mapping[str, ReplayVerdict],
        late: Mapping[str, tuple[int, int]],
        now: datetime,
    ) -> None:
        self.course = course
        played = {
            (one.entrant, one.number): _played_in(one, course.competition, outcomes, verdicts, late)
            for one in course.state.attempts("over")
        }
        self._facts = _Facts(course, played, now)

    @classmethod
    def of(cls, results: Results, course: Course, now: datetime) -> Boards:
        """Return the boards of a run; it is read now, and not kept.

        Raises:
            ExperimentError: the run cannot be read, or the competition has no season.
        """
        return cls(course, results.outcomes(), results.verdicts(), results.late_actions(), now)

    def seen_by(self, viewer: str) -> SeasonBoard:
        """Return the board for `PUBLIC`, for `ORGANISER` or for the entrant of this name."""
        return (self._whole if viewer == ORGANISER else self._public).seen_by(viewer)

    @cached_property
    def _public(self) -> _Board:
        state = self.course.state
        return _Board(self._facts, state.closed is not None, state.frozen_at(self._facts.now))

    @cached_property
    def _whole(self) -> _Board:
        return _Board(self._facts, True, None)


class _Played(NamedTuple):
    """The trials of an attempt that is over.

    scores      verified, shape (tasks, trials), of all proving tasks
    lost        which of them were forfeited, likewise
    late        number of late actions, and of all, of the trials with a rate, shape (tasks, trials, 2)
    forfeits    of its trials
    verified    whether all of them were
    """

    scores: FloatArray
    lost: npt.NDArray[np.bool_]
    late: npt.NDArray[np.int64]
    forfeits: tuple[Forfeit, ...]
    verified: bool


class _Facts(NamedTuple):
    """The data of the boards for all viewers; `played` by an attempt's entrant and number."""

    course: Course
    played: Mapping[tuple[str, int], _Played]
    now: datetime


@dataclass(slots=True)
class _Placed:
    """The standing attempts that place an entrant, by the time from which each does, with their scores.

    Args:
        name: of the entrant.
        since: when each attempt's predecessor, in whose place it stands, was over; in ascending order.
        counting: numbers of the attempts that count.
        totals: scores of all that stand.
        tasks: score of each trial of each task, of the attempts that count, shape (tasks, trials).
        place: see `EntrantRow`.
        like: likewise.
    """

    name: str
    since: list[datetime]
    counting: list[int]
    totals: list[float]
    tasks: FloatArray
    place: int = 0
    like: int | None = None


def _played_in(
    attempt: Attempt,
    competition: Competition,
    outcomes: Mapping[str, TrialEnd],
    verdicts: Mapping[str, ReplayVerdict],
    late: Mapping[str, tuple[int, int]],
) -> _Played:
    levels = attempt.trials((task.name for task in competition.proving), competition.trials)
    trials = levels.values()
    ends, judged = [outcomes.get(trial) for trial in trials], [verdicts.get(trial) for trial in trials]
    reasons = [None if end is None else end.reason for end in ends]
    shape = len(competition.proving), competition.trials
    return _Played(
        np.array([math.nan if one is None else one.score for one in judged]).reshape(shape),
        np.array([reason is not None for reason in reasons]).reshape(shape),
        np.array([late.get(trial, (0, 0)) for trial in trials]).reshape(*shape, 2),
        tuple(Forfeit(*level, why) for level, why in zip(levels, reasons, strict=True) if why is not None),
        None not in ends and all(one is not None and one.problem is None for one in judged),
    )


class _Board:
    """The board for those who may know the same of entrants that are not theirs.

    Args:
        facts: that it is made of.
        told: whether they may know the scores of hidden tasks.
        until: when attempts were over, or withdrawn, that they may know of; None for no limit.
    """

    def __init__(self, facts: _Facts, told: bool, until: datetime | None) -> None:
        self._facts = facts
        self._state = state = facts.course.state
        self._until = until
        proving = facts.course.competition.proving
        self._told = [told or not task.hidden for task in proving]
        self._tasks = tuple(task.name for task in compress(proving, self._told))
        self._hidden = tuple(task.name for task in proving if task.name not in self._tasks)
        self._queue = {(one.entrant, one.number): i for i, one in enumerate(queue(state), 1)}
        self._lowest = self._lowest_scores()
        self._placed = self._places_of()
        self._times = _spread(sorted({time for one in self._placed.values() for time in one.since}))
        self._over_time = _places(list(self._placed.values()), self._times, state.season.count)
        self._acts = [one for one in reversed(facts.course.acts) if one.act in (*_OF_ALL, *_OF_ITS_OWNER)]
        self._rows: dict[str, EntrantRow] = {}

    def seen_by(self, viewer: str) -> SeasonBoard:
        """Return the board for one of them."""
        state, season, now = self._state, self._state.season, self._facts.now
        shown = [self._row(entrant, viewer) for entrant in state.entrants.values()]
        if state.closed is not None:
            phase = "closed"
        else:
            phase = "before" if now < season.opens else "open" if now < season.closes else "over"
        return SeasonBoard(
            self._facts.course.competition.name,
            phase,
            _text(season.opens),
            _text(season.closes),
            _text(self._until),
            state.paused,
            season.count,
            self._tasks,
            self._hidden,
            tuple(sorted(shown, key=lambda row: (row.place or math.inf, row.shown))),
            tuple(map(_text, self._times)),
            tuple((self._shown(one.entrant, viewer), one.number) for one in state.attempts("playing")),
            tuple((self._shown(name, viewer), number) for name, number in self._queue),
            tuple((one.time, one.reason) for one in reversed(state.announcements)),
            tuple(self._acts_for(viewer)),
        )

    def _shown(self, name: str, viewer: str) -> str:
        if _knows(viewer, name) or self._state.season.names == "own":
            return name
        return self._state.entrants[name].act.alias

    def _standing(self, entrant: Enrolled) -> list[tuple[Attempt, Attempt]]:
        """Return the verified attempts that stand; see `Enrolled.standing`."""
        if entrant.excluded:
            return []
        found = entrant.standing(self._until)
        return [(root, one) for root, one in found if self._facts.played[one.entrant, one.number].verified]

    def _lowest_scores(self) -> FloatArray:
        """Return the lowest score of each level among those who played it to the end, as in `_Played`."""
        standing = (one for each in self._state.entrants.values() for _, one in self._standing(each))
        played = [self._facts.played[one.entrant, one.number] for one in standing]
        scores = [np.where(one.lost, np.inf, one.scores) for one in played]
        lowest: FloatArray = np.minimum.reduce(scores, axis=0, initial=np.inf)
        return lowest

    def _scores(self, attempt: Attempt) -> FloatArray:
        """Return the scores of an attempt's trials, shape (tasks, trials), of the tasks that are shown."""
        played = self._facts.played[attempt.entrant, attempt.number]
        scores = np.where(played.lost, np.minimum(played.scores, self._lowest), played.scores)
        return scores[self._told]

    def _places_of(self) -> dict[str, _Placed]:
        found: list[_Placed] = []
        for name, entrant in self._state.entrants.items():
            if standing := self._standing(entrant):
                scores = [self._scores(one) for _, one in standing]
                totals = [_total(one) for one in scores]
                counting = _counting(totals, self._state.season.count)
                since = accumulate((root.ended or root.requested for root, _ in standing), max)
                tasks = np.mean([scores[i] for i in counting], axis=0)
                numbers = [standing[i][1].number for i in counting]
                found.append(_Placed(name, list(since), numbers, totals, tasks))
        _compare(found, self._state.season.count)
        return {one.name: one for one in found}

    def _row(self, entrant: Enrolled, viewer: str) -> EntrantRow:
        """Return the row of an entrant; what others see is made once."""
        if entrant.name == viewer:
            return self._made(entrant, viewer)
        if entrant.name not in self._rows:
            self._rows[entrant.name] = self._made(entrant, viewer)
        return self._rows[entrant.name]

    def _made(self, entrant: Enrolled, viewer: str) -> EntrantRow:
        name, knows, shown = entrant.name, _knows(viewer, entrant.name), self._shown(entrant.name, viewer)
        attempts = [self._attempt(one, knows) for one in entrant.attempts.values()]
        row = EntrantRow(
            shown,
            name if shown == name else "",
            entrant.act.team if shown == name else "",
            counts=dict(Counter(one.state for one in attempts)),
            attempts=tuple(attempts),
            missing=f"excluded: {entrant.excluded}" if entrant.excluded else "no verified attempt yet",
            paused=entrant.paused if knows else "",
            mine=name == viewer,
        )
        if (placed := self._placed.get(name)) is None:
            return row
        low, high = interval(tuple(tuple(trials) for trials in placed.tasks.tolist()))
        return replace(
            row,
            place=placed.place,
            score=_score(placed.totals, self._state.season.count),
            low=low,
            high=high,
            tasks=self._by_task(placed.tasks),
            like=placed.like,
            places=tuple(self._over_time[name]),
            missing="",
            late=self._late(placed),
        )

    def _late(self, placed: _Placed) -> float:
        played = (self._facts.played[placed.name, number] for number in placed.counting)
        late, actions = sum(one.late[self._told].sum(axis=(0, 1)) for one in played)
        return float(late / actions) if actions else math.nan

    def _attempt(self, one: Attempt, knows: bool) -> AttemptRow:
        row = AttemptRow(
            one.number,
            one.state,
            _text(one.requested),
            _text(one.began),
            _text(one.ended),
            place=self._queue.get((one.entrant, one.number), 0),
            instead=one.instead,
            withdrawn=one.withdrawn is not None and (knows or self._is_known(one.withdrawn)),
            why=one.why if knows else "",
        )
        if one.state != "over" or not (knows or self._is_known(one.ended or one.requested)):
            return row
        played = self._facts.played[one.entrant, one.number]
        if not played.verified:
            return replace(row, state="unverified")
        scores = self._scores(one)
        placed = self._placed.get(one.entrant)
        return replace(
            row,
            state="forfeited" if played.forfeits else "verified",
            score=_total(scores),
            tasks=self._by_task(scores),
            counts=placed is not None and one.number in placed.counting,
            forfeits=tuple(
                lost if knows else replace(lost, reason=_rule(lost.reason))
                for lost in played.forfeits
                if lost.task in self._tasks
            ),
        )

    def _is_known(self, time: datetime) -> bool:
        """Return whether others may know what was at this time."""
        return self._until is None or time <= self._until

    def _by_task(self, scores: FloatArray) -> dict[str, float]:
        return {task: float(np.mean(row)) for task, row in zip(self._tasks, scores, strict=True)}

    def _acts_for(self, viewer: str) -> Iterator[Act]:
        """Yield the acts that a viewer may know, newest first, without what they say of players."""
        for one in self._acts:
            name, _, trial = one.subject.partition("/")
            if one.act in _OF_ALL or one.subject == EVERYBODY or _knows(viewer, name):
                shown = self._shown(name, viewer) if name in self._state.entrants else name
                subject = f"{shown}/{trial}" if trial else shown
                yield replace(one, subject=subject, player="", id="", trial="", alias="", team="", token="")


def _knows(viewer: str, name: str) -> bool:
    """Return whether a viewer may know everything about an entrant."""
    return viewer in (ORGANISER, name)


def _rule(reason: str) -> str:
    """Return the reason of a forfeit without what its entrant has chosen: names and messages."""
    if not reason.startswith(_AGENT):
        return reason.partition(": ")[0]
    did = _DID.search(reason)
    return "its agent " + (did[0] if did else "failed")


def _counting(totals: Sequence[float], count: str) -> list[int]:
    """Return which attempts count, of those with these scores; see `Season.count`."""
    if count == "mean":
        return list(range(len(totals)))
    return [len(totals) - 1 if count == "last" else int(np.argmax(totals))]


def _score(totals: Sequence[float], count: str) -> float:
    return float(np.mean([totals[i] for i in _counting(totals, count)]))


def _total(scores: FloatArray) -> float:
    """Return the score of trials with these scores, shape (tasks, trials)."""
    return float(sum(float(np.mean(trials)) for trials in scores))


def _compare(found: Sequence[_Placed], count: str) -> None:
    """Give each entrant a place, and the best place above from which it is not separated."""
    if not found:
        return
    scores = np.array([_score(one.totals, count) for one in found])
    for one, score in zip(found, scores, strict=True):
        one.place = 1 + int(np.sum(scores > score))
    shares = np.array([one.tasks.ravel() / one.tasks.shape[1] for one in found])  # their sums are the scores
    flips = bootstrap_rng().choice((-1.0, 1.0), (shares.shape[1], _FLIPS))
    sums, flipped = shares.sum(axis=1), shares @ flips
    ranked = sorted(range(len(found)), key=lambda i: found[i].place)
    for i in ranked:
        for above in reversed(ranked[: found[i].place - 1]):
            observed = abs(sums[above] - sums[i])
            by_chance = np.abs(flipped[above] - flipped[i]) >= (1 - _ROUNDING) * observed
            if (1 + np.count_nonzero(by_chance)) / (1 + _FLIPS) <= _LEVEL:
                break
            found[i].like = found[above].place


def _places(found: Sequence[_Placed], times: Sequence[datetime], count: str) -> dict[str, list[int | None]]:
    """Return the place of each entrant at each time, by name."""
    scores = []
    for one in found:
        after = [math.nan, *(_score(one.totals[: i + 1], count) for i in range(len(one.totals)))]
        scores.append([after[bisect_right(one.since, time)] for time in times])
    places: dict[str, list[int | None]] = {one.name: [] for one in found}
    for column in np.array(scores).T:
        above = np.searchsorted(np.sort(-column), -column)  # NaN is last
        for one, number, score in zip(found, above.tolist(), column, strict=True):
            places[one.name].append(None if np.isnan(score) else 1 + number)
    return places


def _spread(times: Sequence[datetime]) -> list[datetime]:
    """Return at most `_TIMES` of these times, the last one among them."""
    if len(times) <= _TIMES:
        return list(times)
    return [times[round(i)] for i in np.linspace(0, len(times) - 1, _TIMES)]


def _text(time: datetime | None) -> str:
    return "" if time is None else time_text(time)
