"""The state of a competition: what the acts of its journal have made of it. No clock and no file is read."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field, replace
from datetime import date, datetime
from typing import Final, Literal

from experiment_runner.competition.records import journal
from experiment_runner.competition.records.journal import EVERYBODY, Act
from experiment_runner.competition.records.record import is_name
from experiment_runner.competition.settings import Season, changed
from experiment_runner.plan.limits import TrialId
from glue.errors import ExperimentError

IMAGE_ID: Final = re.compile(r"sha256:[0-9a-f]{64}")
"""The ids of images."""

AttemptState = Literal["waiting", "playing", "over", "ours", "cancelled"]


@dataclass(frozen=True, slots=True)
class Attempt:
    """An attempt: every proving task, as many trials of each as the competition has.

    Args:
        entrant: name of its owner.
        number: among its owner's, from 1.
        requested: when it was queued.
        state: `waiting`, then `playing`, then one of the others, which are final. `over` were played to the
            end or forfeited; `ours` were not, for a reason that is not the entrant's; `cancelled` never
            began.
        start: the act that let it play, with its player; None before.
        ended: when it got its final state; None before.
        why: of `ours` and `cancelled`, the reason; of `over`, why it was forfeited, empty if it was not.
        withdrawn: when its owner has withdrawn it, so that neither it nor what was run again instead of it
            counts; None if it was not.
        instead: number of the attempt instead of which it counts; 0 if it is no rerun.
        day: the day to which it is charged, unless it is `ours` or `cancelled`; None if it costs nothing, or
            one of the granted attempts.
        granted: whether it costs one of the granted attempts, likewise.
        order: number of the act that queued it, which orders attempts also if the clock was set back.
    """

    entrant: str
    number: int
    requested: datetime
    state: AttemptState = "waiting"
    start: Act | None = None
    ended: datetime | None = None
    why: str = ""
    withdrawn: datetime | None = None
    instead: int = 0
    day: date | None = None
    granted: bool = False
    order: int = 0

    @property
    def began(self) -> datetime | None:
        """When it was let play; None before."""
        return None if self.start is None else self.start.when

    def trials(self, tasks: Iterable[str], count: int) -> dict[tuple[str, int], TrialId]:
        """Return the ids of its trials, by task and level, where each task has `count` trials."""
        before = (self.number - 1) * count
        return {(task, i): TrialId.of(self.entrant, task, before + i) for task in tasks for i in range(count)}


@dataclass(slots=True)
class Enrolled:
    """An entrant, and its attempts in a season.

    Args:
        act: that admitted it.
        image: the act with the image that it has submitted last; None if it has submitted none.
        attempts: by number, in the order in which they were queued.
        excluded: the reason; empty if it is not excluded.
        paused: the reason; empty if it is not paused.
        amends: when it was paused for what it forfeits, until it submits another image or, as its program
            may change unseen behind a key, until the next day; None if it was paused otherwise.
        granted: number of attempts that are left of those that were granted.
        used: number of attempts that were charged to each day.
        failed: attempts that it has forfeited in a row since its last image, or since it was resumed.
        served: number of the act that last let an attempt of it play; 0 if none was.
        current: its attempts that wait or play, by number.
    """

    act: Act
    image: Act | None = None
    attempts: dict[int, Attempt] = field(default_factory=dict)
    excluded: str = ""
    paused: str = ""
    amends: datetime | None = None
    granted: int = 0
    used: Counter[date] = field(default_factory=Counter)
    failed: int = 0
    served: int = 0
    current: dict[int, Attempt] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Its name."""
        return self.act.subject

    @property
    def present(self) -> Act:
        """The act that admitted it, with its present player and id."""
        if self.image is None:
            return self.act
        return replace(self.act, player=self.image.player, id=self.image.id)

    @property
    def key(self) -> str:
        """Its public key; empty if the organiser's file names its program."""
        return "" if IMAGE_ID.fullmatch(self.act.id) else self.act.id

    @property
    def playing(self) -> Attempt | None:
        """Its attempt that is playing."""
        return next((one for one in self.current.values() if one.state == "playing"), None)

    @property
    def waiting(self) -> list[Attempt]:
        """Its attempts that wait, oldest first."""
        return [one for one in self.current.values() if one.state == "waiting"]

    def standing(self, until: datetime | None = None) -> Iterator[tuple[Attempt, Attempt]]:
        """Yield each attempt that is over and was not replaced by one that is over, after the attempt in
        whose place it stands: itself, or the first of those that were run again. None of them was withdrawn.

        Args:
            until: what was over or withdrawn later is not yet; None for no limit.
        """
        last: dict[int, Attempt] = {}
        withdrawn: set[int] = set()
        for one in self.attempts.values():
            root = one
            while root.instead:
                root = self.attempts[root.instead]
            if one.state == "over" and (until is None or (one.ended or one.requested) <= until):
                last[root.number] = one
            if one.withdrawn is not None and (until is None or one.withdrawn <= until):
                withdrawn.add(root.number)
        for number in sorted(last.keys() - withdrawn):
            yield self.attempts[number], last[number]


@dataclass(slots=True)
class State:
    """The state of a competition after the acts of its journal.

    Args:
        rules: of its season, with the changes that were made to them; None if it has none.
        entrants: by name, in the order of their admission.
        paused: the reason why nothing is let play; empty if anything is.
        frozen: when the public board was frozen by an act; None if it was not, or was thawed.
        thawed: when it was thawed last, which also overrules a `Season.freeze` of before; None if never.
        closed: when the season was closed; None if it was not.
        announcements: oldest first.
        count: number of acts.
    """

    rules: Season | None
    entrants: dict[str, Enrolled] = field(default_factory=dict)
    paused: str = ""
    frozen: datetime | None = None
    thawed: datetime | None = None
    closed: datetime | None = None
    announcements: list[Act] = field(default_factory=list)
    count: int = 0

    @property
    def season(self) -> Season:
        """The rules of the season.

        Raises:
            ExperimentError: there is no season.
        """
        if self.rules is None:
            raise ExperimentError("the competition has no season: its file has no table [season]")
        return self.rules

    def apply(self, one: Act) -> None:
        """Take the next act of the journal into account.

        Raises:
            ExperimentError: it cannot have been.
        """
        self.count += 1
        match one.act:
            case journal.ENTER | journal.ADD | journal.ENROL if not (
                is_name(one.subject) and one.alias.isprintable() and "/" not in one.alias
            ):
                raise ExperimentError(f"the journal admits {one.subject!r:.80}, which cannot be a name")
            case journal.ENROL if (had := self.entrants.get(one.subject)) and had.key == one.id != "":
                had.act = replace(had.act, token=one.token)
            case journal.ADD | journal.ENROL if one.subject in self.entrants:
                raise ExperimentError(f"the journal admits {one.subject:.80} twice")
            case journal.ENTER | journal.ADD | journal.ENROL:
                self.entrants[one.subject] = Enrolled(one)
            case journal.FREEZE:
                self.frozen = one.when
            case journal.THAW:
                self.frozen, self.thawed = None, one.when
            case journal.ANNOUNCE:
                self.announcements.append(one)
            case journal.CHANGE:
                self.rules = changed(self.season, one.subject, one.value)
            case journal.CLOSE:
                self.closed, self.paused = one.when, ""
                for entrant in self.entrants.values():
                    entrant.paused = ""
            case journal.PAUSE | journal.RESUME if one.subject == EVERYBODY:
                self.paused = one.reason if one.act == journal.PAUSE else ""
            case journal.RERUN if one.trial:
                pass  # of a trial, see `Course.reruns`
            case journal.REQUEST | journal.RERUN:
                self._queue(one)
            case journal.START | journal.OVER | journal.OURS | journal.CANCEL | journal.WITHDRAW:
                self._move(one)
            case journal.EXCLUDE | journal.READMIT:
                self.entrant(one.subject).excluded = one.reason if one.act == journal.EXCLUDE else ""
            case journal.GRANT:
                self.entrant(one.subject).granted += one.number
            case journal.PAUSE:
                entrant = self.entrant(one.subject)
                entrant.paused, entrant.amends = one.reason, one.when if one.number else None
            case journal.RESUME:
                entrant = self.entrant(one.subject)
                entrant.paused, entrant.failed = "", 0
            case journal.IMAGE:
                entrant = self.entrant(one.subject)
                entrant.image, entrant.failed = one, 0
                if entrant.amends:
                    entrant.paused = ""
            case _:
                raise ExperimentError(f"the journal has an act {one.act!r:.80}, which there is not")

    def entrant(self, name: str) -> Enrolled:
        """Return an entrant.

        Raises:
            ExperimentError: there is none of this name.
        """
        if name not in self.entrants:
            raise ExperimentError(f"there is no entrant {name:.80}")
        return self.entrants[name]

    def taking_part(self, name: str) -> Enrolled:
        """Return an entrant that is not excluded.

        Raises:
            ExperimentError: it is, or there is none of this name.
        """
        entrant = self.entrant(name)
        if entrant.excluded:
            raise ExperimentError(f"{name} is excluded: {entrant.excluded}")
        return entrant

    def attempt(self, name: str, number: int) -> Attempt:
        """Return an attempt.

        Raises:
            ExperimentError: there is none of this entrant and number.
        """
        attempts = self.entrant(name).attempts
        if number not in attempts:
            raise ExperimentError(f"{name} has no attempt {number}")
        return attempts[number]

    def attempts(self, *states: AttemptState) -> list[Attempt]:
        """Return all attempts in these states; the cost of those that wait or play depends on no others."""
        current = not {*states} - {"waiting", "playing"}
        return [
            one
            for entrant in self.entrants.values()
            for one in (entrant.current if current else entrant.attempts).values()
            if one.state in states
        ]

    def frozen_at(self, now: datetime) -> datetime | None:
        """Return since when the public board is frozen; None if it is not."""
        if self.closed is not None:
            return None
        freeze, thawed = self.season.freeze, self.thawed
        planned = freeze is not None and freeze <= now and (thawed is None or thawed < freeze)
        return freeze if self.frozen is None and planned else self.frozen

    def _queue(self, one: Act) -> None:
        entrant = self.entrant(one.subject)
        if one.number != len(entrant.attempts) + 1:
            raise ExperimentError(
                f"the journal queues attempt {one.number} of {one.subject}, who has {len(entrant.attempts)}"
            )
        made = Attempt(one.subject, one.number, one.when, order=self.count)
        if one.act == journal.RERUN:  # which costs nothing
            made = replace(made, instead=self.attempt(one.subject, one.instead).number)
        elif one.instead:  # of one that failed here: it costs what that one did
            failed = self.attempt(one.subject, one.instead)
            made = replace(made, day=failed.day, granted=failed.granted)
        else:
            day = made.requested.astimezone(self.season.days).date()
            granted = entrant.used[day] >= self.season.attempts_per_day
            made = replace(made, day=None if granted else day, granted=granted)
        self._charge(entrant, made, 1)
        entrant.attempts[one.number] = entrant.current[one.number] = made

    @staticmethod
    def _charge(entrant: Enrolled, one: Attempt, count: int) -> None:
        if one.day is not None:
            entrant.used[one.day] += count
        entrant.granted -= count * one.granted

    def _move(self, one: Act) -> None:
        entrant, was = self.entrant(one.subject), self.attempt(one.subject, one.number)
        if was.state not in _BEFORE[one.act]:
            raise ExperimentError(
                f"the journal has {one.act} of attempt {was.number} of {was.entrant}, which was {was.state}"
            )
        match one.act:
            case journal.START:
                new = replace(was, state="playing", start=one)
                entrant.served = self.count
            case journal.OVER:
                new = replace(was, state="over", ended=one.when, why=one.reason)
                entrant.failed = entrant.failed + 1 if one.reason else 0
            case journal.WITHDRAW:
                new = replace(was, withdrawn=one.when)
            case _:
                state: AttemptState = "ours" if one.act == journal.OURS else "cancelled"
                new = replace(was, state=state, ended=one.when, why=one.reason)
                self._charge(entrant, was, -1)
        entrant.attempts[was.number] = new
        entrant.current.pop(was.number, None)
        if new.state == "playing":
            entrant.current[was.number] = new


_BEFORE: Final[dict[str, tuple[AttemptState, ...]]] = {
    journal.START: ("waiting",),
    journal.OVER: ("playing",),
    journal.OURS: ("waiting", "playing"),
    journal.CANCEL: ("waiting",),
    journal.WITHDRAW: ("over",),
}
"""The states of an attempt in which an act can be about it."""
