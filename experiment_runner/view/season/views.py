"""A season as its viewers see it, read from its directory whenever it has changed."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import Final, NamedTuple

from experiment_runner.competition.course import Course, course_of
from experiment_runner.competition.records.record import record_path
from experiment_runner.competition.season.board import ORGANISER, PUBLIC, Boards, SeasonBoard
from experiment_runner.competition.season.state import SeasonState
from experiment_runner.plan.ids import TrialId
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.store.database import DATABASE_FILES, reported
from experiment_runner.store.layout import JOURNAL_FILE, TOKEN_FILE
from experiment_runner.store.results import Results
from experiment_runner.view.catalog import version
from experiment_runner.view.episodes import episodes_in
from experiment_runner.view.reader import Cache, as_json
from experiment_runner.view.season.feed import feed_of
from experiment_runner.view.season.replays import replayed
from experiment_runner.view.season.shown import board_as_json, entrant_as_json, row_of, rules_of
from experiment_runner.view.server import new_token
from glue.files import create_regular, read_regular

_MOST_ANSWERS: Final = 512
_MOST_TOKEN: Final = 1024
_REST: Final = 5
"""Multiple of its computing time for which a board is kept: with very many attempts it takes seconds."""

_SECONDS: Final = 60
"""A board may change with time alone, as when the season opens; it is computed again at least this often."""


def utc_now() -> datetime:
    """Return the time."""
    return datetime.now(UTC)


class View(NamedTuple):
    """A board, for one viewer, and the season that it is of."""

    board: SeasonBoard
    state: SeasonState
    course: Course


class _Season(NamedTuple):
    """A season as it was read."""

    boards: Boards
    state: SeasonState
    course: Course


class Views:
    """What each viewer of a season may see. May be called from any thread.

    Args:
        directory: of the season.
        clock: returns the time.
    """

    def __init__(self, directory: Path, clock: Callable[[], datetime]) -> None:
        self.directory = directory
        self._clock = clock
        self._lock = threading.Lock()
        self._cache = Cache(_MOST_ANSWERS, _REST)

    def view(self, viewer: str) -> View:
        """Return what a viewer may see.

        Raises:
            ExperimentError: the season cannot be read.
        """
        with self._lock:
            return self._view(viewer)

    def _view(self, viewer: str) -> View:
        season: _Season = self._cache.get("season", self._signs(), self._read)
        return View(season.boards.seen_by(viewer), season.state, season.course)

    def board(self, viewer: str) -> bytes:
        """Return the board as JSON."""

        def compute() -> bytes:
            board, state, course = self._view(viewer)
            rules = rules_of(course.competition, state.season)
            return as_json(board_as_json(board, state, rules, viewer, self._clock())).encode()

        return self._answer("board", viewer, compute)

    def entrant(self, viewer: str, shown: str) -> bytes:
        """Return an entrant with its attempts as JSON.

        Raises:
            KeyError: this viewer knows no entrant of that name.
        """
        return self._answer(
            f"entrant {shown}",
            viewer,
            lambda: as_json(entrant_as_json(self._view(viewer).board, shown)).encode(),
        )

    def feed(self, viewer: str) -> bytes:
        """Return what happens in the season as an Atom feed."""
        return self._answer("feed", viewer, lambda: feed_of(self._view(viewer).board))

    def viewers(self) -> dict[str, str]:
        """Return who may see more than others, by the digest of their token: an entrant, or `ORGANISER`.

        Raises:
            ExperimentError: the season cannot be read.
        """
        entrants = SeasonState.of(course_of(self.directory)).entrants
        found = {one.act.token: name for name, one in entrants.items() if one.act.token}
        return found | {digest_of(organisers_token(self.directory)): ORGANISER}

    def replays(self, viewer: str, shown: str, attempt: int) -> bytes:
        """Return the episodes of a verified attempt as JSON, trial by trial.

        Raises:
            KeyError: there is no such attempt, or this viewer may not see it.
        """
        found = []
        for trial in self._trials(viewer, shown, attempt):
            _, task, number = trial.parts
            trials = self.view(viewer).course.competition.trials
            found.append(
                {
                    "task": task,
                    "trial": number % trials,
                    **episodes_in(record_path(self.directory, trial)),
                }
            )
        return as_json(found).encode()

    def replay(self, viewer: str, shown: str, attempt: int, task: str, trial: int, episode: int) -> bytes:
        """Return an episode of a verified attempt; see `replayed`.

        Raises:
            KeyError: there is no such trial, or this viewer may not see it.
            HTTPException: there is no such episode.
        """
        trials = self.view(viewer).course.competition.trials
        for found in self._trials(viewer, shown, attempt):
            if found.parts[1:] == (task, (attempt - 1) * trials + trial):
                name = f"{shown}, attempt {attempt}: {task}, trial {trial}"
                return replayed(name, self._spec(found), record_path(self.directory, found), episode)
        raise KeyError(task)

    def _trials(self, viewer: str, shown: str, attempt: int) -> list[TrialId]:
        """Return the trials of a verified attempt whose tasks this viewer may know."""
        board, state, course = self.view(viewer)
        row = row_of(board, shown)
        if not any(one.number == attempt and one.state == "verified" for one in row.attempts):
            raise KeyError(shown)
        name = row.name or next(
            (name for name, one in state.entrants.items() if one.act.alias == shown), shown
        )
        trials = course.competition.trials
        return [
            TrialId.of(name, task, number)
            for task in board.tasks
            for number in range((attempt - 1) * trials, attempt * trials)
        ]

    def _spec(self, trial: TrialId) -> TrialSpec:
        with Results.open(self.directory) as results:
            return next(one.spec for one in results.trials() if one.spec.id == trial)

    def _answer(self, what: str, viewer: str, compute: Callable[[], bytes]) -> bytes:
        with self._lock:
            found: bytes = self._cache.get((what, viewer), self._signs(), compute)
            return found

    def _read(self) -> _Season:
        course = course_of(self.directory)
        with Results.open(self.directory) as results:
            boards = Boards(course, results.outcomes(), results.verdicts(), self._clock())
        boards.seen_by(PUBLIC)  # counts as part of the time that it takes
        return _Season(boards, SeasonState.of(course), course)

    def _signs(self) -> object:
        names = (*DATABASE_FILES[:2], JOURNAL_FILE)
        return (
            int(self._clock().timestamp()) // _SECONDS,
            *(version(self.directory / name) for name in names),
        )


def digest_of(token: str) -> str:
    """Return the digest by which a token is known."""
    return sha256(token.encode()).hexdigest()


def organisers_token(directory: Path) -> str:
    """Return the secret with which the page shows everything; it is made when it is first asked for.

    Raises:
        StorageError: its file cannot be read, or not be written.
    """
    path = directory / TOKEN_FILE
    with reported(f"cannot read {path}"):
        try:
            return read_regular(path, _MOST_TOKEN, own=True).decode().strip()
        except FileNotFoundError:
            token = new_token()
    with reported(f"cannot write {path}"), create_regular(path, 0o600) as file:
        file.write(f"{token}\n".encode())
        file.flush()
        os.fsync(file.fileno())
    return token
