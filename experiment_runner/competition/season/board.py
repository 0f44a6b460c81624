"""The board of a season: a function of its journal and records, for the eyes of one viewer.

Only verified attempts have a score: the sum over the tasks of the mean over their trials, each the sum of all
its rewards. A forfeited trial scores as in `experiment_runner.competition.board.standings`.
Entrants are ordered by the unrounded score of the attempts that count. An attempt that was run again is, with
everything that follows from it, as if it had been so from the start.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import datetime
from typing import Final

from experiment_runner.competition.board.standings import Forfeit
from experiment_runner.competition.course import Course
from experiment_runner.competition.records.journal import Act
from experiment_runner.store.results import Results

PUBLIC: Final = ""
"""The viewer who is nobody in particular."""

ORGANISER: Final = "*"
"""The viewer who sees everything, at once. Any other viewer is the name of an entrant."""


@dataclass(frozen=True, slots=True)
class AttemptRow:
    """An attempt on the board. Times are UTC, as in the journal; empty if there is none.

    Args:
        number: among its entrant's, from 1.
        state: `waiting`, `playing`, `verified`, `forfeited`, `unverified` (its replay did not match, or has
            not ended), `ours` or `cancelled`.
        requested, began, ended: times.
        score: see above, over the tasks that this viewer may know; NaN unless verified or forfeited.
        tasks: the score of each of these tasks.
        counts: whether it is among those that make its entrant's score.
        forfeits: of its trials; numbers are those of the levels, from 0.
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
        like: the best place above from which it is not separated: a paired randomisation test over the
            levels, which both have played, does not reject at 5 % that they are equal; None if there is none.
        counts: number of attempts in each state that there was.
        attempts: oldest first.
        places: its place at each of `SeasonBoard.times`; None before it had one.
        missing: why it has no place; empty if it has one.
        paused: why its attempts wait, for its owner and the organiser; empty if they need not.
        mine: whether this viewer is its owner.
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
    raise NotImplementedError
