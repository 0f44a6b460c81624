"""A season as its viewers see it, read from its directory whenever it has changed."""

from __future__ import annotations

import os
import threading
from collections.abc import Callable, Hashable
from contextlib import suppress
from datetime import datetime
from hashlib import sha256
from pathlib import Path
from typing import Final

from experiment_runner.competition.course import course_of
from experiment_runner.competition.records.copies import with_copies
from experiment_runner.competition.records.record import record_path
from experiment_runner.competition.season.board import ORGANISER, PUBLIC, Boards
from experiment_runner.competition.state import State
from experiment_runner.plan.limits import TrialId
from experiment_runner.store.database import DATABASE_FILES, reported
from experiment_runner.store.layout import JOURNAL_FILE, TOKEN_FILE
from experiment_runner.store.results import Results
from experiment_runner.view.catalog import version
from experiment_runner.view.episodes import episodes_in
from experiment_runner.view.season.feed import feed_of
from experiment_runner.view.season.replays import replayed
from experiment_runner.view.season.shown import board_as_json, entrant_as_json, row_of, rules_of
from experiment_runner.view.server import new_token
from experiment_runner.view.stream import Cache, as_json
from glue.files import create_regular, read_regular

_MOST_ANSWERS: Final = 512
_MOST_TOKEN: Final = 1024
_REST: Final = 5
"""Multiple of its computing time for which a board is kept: with very many attempts it takes seconds."""

_SECONDS: Final = 60
"""A board may change with time alone, as when the season opens; it is computed again at least this often."""


class Views:
    """The contents of a season that each viewer may see. May be called from any thread.

    Args:
        directory: of the season.
        clock: returns the time.
    """

    def __init__(self, directory: Path, clock: Callable[[], datetime]) -> None:
        self.directory = directory
        self._clock = clock
        self._lock = threading.RLock()
        self._cache = Cache(_MOST_ANSWERS, _REST)
        self._known: tuple[object, dict[str, str]] = object(), {}
        self._signs: object = None  # of the boards, which differ when the season has changed

    @property
    def state(self) -> State:
        """The state of the season.

        Raises:
            ExperimentError: the season cannot be read.
        """
        return self._boards().course.state

    def board(self, viewer: str) -> bytes:
        """Return the board as JSON."""

        def compute(boards: Boards) -> object:
            state = boards.course.state
            rules = rules_of(boards.course.competition, state.season)
            return board_as_json(boards.seen_by(viewer), state, rules, viewer, self._clock())

        return self._json(("board", viewer), compute)

    def entrant(self, viewer: str, shown: str) -> bytes:
        """Return an entrant with its attempts as JSON.

        Raises:
            KeyError: this viewer knows no entrant of that name.
        """
        return self._json(
            ("entrant", viewer, shown), lambda boards: entrant_as_json(boards.seen_by(viewer), shown)
        )

    def feed(self) -> bytes:
        """Return the events of the season as an Atom feed."""
        with self._lock:
            return feed_of(self._boards().seen_by(PUBLIC))

    def viewers(self) -> dict[str, str]:
        """Return who may see more than others, by the digest of their token: an entrant, or `ORGANISER`.

        Raises:
            ExperimentError: the season cannot be read.
        """
        with self._lock:
            signs = version(self.directory / JOURNAL_FILE)
            if self._known[0] != signs:
                entrants = course_of(self.directory).state.entrants.items()
                found = {one.act.token: name for name, one in entrants if one.act.token}
                organiser = digest_of(organisers_token(self.directory))
                self._known = signs, found | {organiser: ORGANISER}
            return self._known[1]

    def replays(self, viewer: str, shown: str, attempt: int) -> bytes:
        """Return the episodes of a verified attempt as JSON, trial by trial.

        Raises:
            KeyError: there is no such attempt, or this viewer may not see it.
        """
        trials = self._trials(viewer, shown, attempt).items()
        return as_json(
            [
                {"task": task, "trial": number, **episodes_in(record_path(self.directory, trial))}
                for (task, number), trial in trials
            ]
        ).encode()

    def replay(self, viewer: str, shown: str, attempt: int, task: str, trial: int, episode: int) -> bytes:
        """Return an episode of a verified attempt; see `replayed`.

        Raises:
            KeyError: there is no such trial, or this viewer may not see it.
            HTTPException: there is no such episode.
        """
        found = self._trials(viewer, shown, attempt)[task, trial]
        with Results.open(self.directory) as results:
            spec = next(one.spec for one in results.trials() if one.spec.id == found)
        name = f"{shown}, attempt {attempt}: {task}, trial {trial}"
        return replayed(name, with_copies(spec, self.directory), record_path(self.directory, found), episode)

    def _trials(self, viewer: str, shown: str, number: int) -> dict[tuple[str, int], TrialId]:
        """Return the trials of a verified attempt, of tasks that this viewer may know, by task and number."""
        with self._lock:
            boards = self._boards()
            board = boards.seen_by(viewer)
        row = row_of(board, shown)
        if not any(one.number == number and one.state == "verified" for one in row.attempts):
            raise KeyError(shown)
        state, count = boards.course.state, boards.course.competition.trials
        aliases = {one.act.alias: name for name, one in state.entrants.items()}
        return state.attempt(row.name or aliases[shown], number).trials(board.tasks, count)

    def _json(self, question: Hashable, compute: Callable[[Boards], object]) -> bytes:
        with self._lock:
            boards = self._boards()
            # Not the signs of this moment: the boards may be those of a moment ago.
            found: bytes = self._cache.get(question, self._signs, lambda: as_json(compute(boards)).encode())
            return found

    def _boards(self) -> Boards:
        names = (*DATABASE_FILES[:2], JOURNAL_FILE)
        with self._lock:
            minute = int(self._clock().timestamp()) // _SECONDS
            signs = minute, *(version(self.directory / name) for name in names)
            found: Boards = self._cache.get("boards", signs, lambda: self._read(signs))
            return found

    def _read(self, signs: object) -> Boards:
        course = course_of(self.directory)
        with Results.open(self.directory) as results:
            boards = Boards.of(results, course, self._clock())
        boards.seen_by(PUBLIC)  # counts as part of the time that it takes
        self._signs = signs
        return boards


def digest_of(token: str) -> str:
    """Return the digest by which a token is known."""
    return sha256(token.encode()).hexdigest()


def organisers_token(directory: Path) -> str:
    """Return the secret with which the page shows everything; it is made when it is first asked for.

    Raises:
        StorageError: its file cannot be read, or not be written.
    """
    path = directory / TOKEN_FILE
    with reported(f"cannot read {path}"), suppress(FileNotFoundError):
        return read_regular(path, _MOST_TOKEN, own=True).decode().strip()
    token = new_token()
    with reported(f"cannot write {path}"), create_regular(path, 0o600) as file:
        file.write(f"{token}\n".encode())
        file.flush()
        os.fsync(file.fileno())
    return token
