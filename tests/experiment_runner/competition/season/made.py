"""A season whose attempts are made up: its journal is real, but nobody has played."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from experiment_runner.competition.course import Course
from experiment_runner.competition.records import journal
from experiment_runner.competition.records.journal import EVERYBODY, Act, act
from experiment_runner.competition.season.board import PUBLIC, Boards, EntrantRow, SeasonBoard
from experiment_runner.competition.settings import parse_competition
from experiment_runner.competition.state import State
from experiment_runner.plan.limits import TrialId
from experiment_runner.store.records import ReplayVerdict, TrialEnd

FILE = """
name = "spring"
trials = 2
seed_env = "S"
[season]
opens = 2026-12-01T00:00:00Z
closes = 2026-12-20T00:00:00Z
enrol = "open"
[tasks]
walk = { env = "skeleton", episodes = 1, phase = "proving" }
unseen = { env = "skeleton", episodes = 1, phase = "proving", hidden = true }
final = { env = "skeleton", episodes = 1 }
"""

SECRET = b"nobody knows"


class Made:
    """The journal of a season and the results of its trials; its clock goes a minute with each act.

    Args:
        names: of entrants that enrol at once.
        text: of its file.
    """

    def __init__(self, names: Sequence[str] = (), text: str = FILE) -> None:
        self.text = text
        self.competition = parse_competition(text, Path("spring.toml"))
        self.now = datetime(2026, 12, 1, 9, tzinfo=UTC)
        self.acts: list[Act] = []
        self.outcomes: dict[str, TrialEnd] = {}
        self.verdicts: dict[str, ReplayVerdict] = {}
        self.late: dict[str, tuple[int, int]] = {}
        for name in names:
            self.act(journal.ENROL, name, player=f"{name}.pub", id=f"key of {name}", alias=f"alias of {name}")

    @property
    def course(self) -> Course:
        """The course of the season."""
        return Course(self.competition, self.acts)

    @property
    def state(self) -> State:
        """The state of the season."""
        return self.course.state

    def act(self, kind: str, subject: str = EVERYBODY, reason: str = "", **more: Any) -> None:
        """Add an act."""
        self.now += timedelta(minutes=1)
        self.acts.append(act(kind, subject, reason, now=self.now, **more))

    def attempt(
        self, name: str, *scores: float, unseen: float = 0.0, forfeit: str = "", instead: int = 0
    ) -> int:
        """Let an entrant play an attempt; return its number.

        Args:
            name: of the entrant.
            scores: of the trials of the task `walk`, which repeat.
            unseen: of all trials of the task `unseen`.
            forfeit: why the last trial of `walk` was forfeited; empty if it was not.
            instead: number of the attempt that it replaces.
        """
        number = 1 + sum(
            one.act in (journal.REQUEST, journal.RERUN) and one.subject == name for one in self.acts
        )
        kind = journal.RERUN if instead else journal.REQUEST
        self.act(kind, name, "a mail", number=number, instead=instead)
        self.act(journal.START, name, number=number, player=f"{name}.pub", id=f"key of {name}")
        count = self.competition.trials
        for task in self.competition.proving:
            for trial in range(count):
                left = forfeit if task.name == "walk" and trial == count - 1 else ""
                score = unseen if task.name == "unseen" else scores[trial % len(scores)]
                trial_id = TrialId.of(name, task.name, (number - 1) * count + trial)
                self.outcomes[trial_id] = TrialEnd(left or None, b"digest")
                self.verdicts[trial_id] = ReplayVerdict(b"digest", None, score)
        self.act(journal.OVER, name, forfeit, number=number)
        return number

    def board(self, viewer: str = PUBLIC) -> SeasonBoard:
        """Return the board now."""
        return Boards(self.course, self.outcomes, self.verdicts, self.late, self.now).seen_by(viewer)

    def rows(self, viewer: str = PUBLIC) -> dict[str, EntrantRow]:
        """Return the rows of the board by what they show."""
        return {row.shown: row for row in self.board(viewer).entrants}
