"""Reading a run directory."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt

from experiment_runner.plan import COUNTS, RoleSpec, TrialSpec
from experiment_runner.store.database import Database, open_to_read, reported
from experiment_runner.store.records import (
    Answered,
    Checkpoint,
    EpisodeResult,
    Event,
    Outcome,
    Totals,
    TrialRecord,
    Verdict,
    Void,
)
from glue.closing import Closing
from glue.errors import ExperimentError

__all__ = ["Results"]

_Types = tuple[type, ...]
_TEXT: Final[_Types] = (str,)
_TEXT_OR_NULL: Final[_Types] = (str, type(None))
_WHOLE: Final[_Types] = (int,)
_NUMBER: Final[_Types] = (int, float)
_NUMBER_OR_NULL: Final[_Types] = (int, float, type(None))
_BYTES: Final[_Types] = (bytes,)
_LAST_SECOND: Final = 253_402_300_799  # of the year 9999, the last that a date can have


class Results(Closing):
    """Reads a run directory, also while it is written to. A context manager that closes it.

    A run may come from anyone, so everything read is checked. Every method raises `ExperimentError` when
    the database cannot be read, or contains values that no run has.
    """

    def __init__(self, directory: Path, database: Database) -> None:
        self.directory = directory
        self._database = database

    @classmethod
    def open(cls, directory: Path) -> Self:
        """Return the results in a run directory, for reading.

        Raises:
            ExperimentError: there is no run, or it cannot be read.
        """
        with reported(f"cannot read {directory}"):
            return cls(directory, open_to_read(directory))

    def close(self) -> None:
        """Close the files."""
        self._database.close()

    def trials(self) -> list[TrialRecord]:
        """Return the record of every trial, in the order of the plan."""
        rows = self._query(
            """SELECT id, agent, environment, trials.episodes, max_steps, seed,
                (SELECT count(*) FROM episodes WHERE trial = key), ifnull(voided, 0), failure
                FROM trials LEFT JOIN
                (SELECT trial, count(*) AS voided FROM voids GROUP BY trial) AS v ON v.trial = key
                ORDER BY key"""
        )
        self._check(rows, (_TEXT, _TEXT_OR_NULL, _TEXT_OR_NULL, *[_WHOLE] * 5, _TEXT_OR_NULL))
        return [self._trial(*row) for row in rows]

    def episodes(self, trial_id: str) -> list[EpisodeResult]:
        """Return the episodes of a trial so far, in order; a return may be NaN."""
        rows = self._query(
            """SELECT episode, episode_return, steps, terminal, wall_time FROM episodes
                WHERE trial = (SELECT key FROM trials WHERE id = ?) ORDER BY episode""",
            trial_id,
        )
        self._check(rows, (_WHOLE, _NUMBER_OR_NULL, _WHOLE, _WHOLE, _NUMBER), numbered=True)
        return [
            EpisodeResult(episode, math.nan if total is None else total, steps, bool(terminal), wall_time)
            for episode, total, steps, terminal, wall_time in rows
        ]

    def returns(self, trial_id: str) -> npt.NDArray[np.float64]:
        """Return the episode returns of a trial so far, shape (episodes,)."""
        rows = self._query(
            """SELECT episode, episode_return FROM episodes
                WHERE trial = (SELECT key FROM trials WHERE id = ?) ORDER BY episode""",
            trial_id,
        )
        self._check(rows, (_WHOLE, _NUMBER_OR_NULL), numbered=True)
        return np.array([total for _, total in rows], np.float64)  # None becomes NaN

    def steps(self, trial_id: str) -> npt.NDArray[np.int64]:
        """Return the numbers of steps of a trial's episodes so far, shape (episodes,)."""
        rows = self._query(
            """SELECT episode, steps FROM episodes
                WHERE trial = (SELECT key FROM trials WHERE id = ?) ORDER BY episode""",
            trial_id,
        )
        self._check(rows, (_WHOLE, _WHOLE), numbered=True)
        return np.array([steps for _, steps in rows], np.int64)

    def totals(self, trial_id: str, last: int | None = None) -> Totals:
        """Return sums over the episodes of a trial so far, or over the last `last`; in constant memory."""
        rows = self._query(
            """SELECT count(*), ifnull(sum(steps), 0), ifnull(sum(NOT terminal), 0),
                sum(episode_return), count(episode_return) FROM
                (SELECT * FROM episodes WHERE trial = (SELECT key FROM trials WHERE id = ?)
                ORDER BY episode DESC LIMIT ?)""",
            trial_id,
            -1 if last is None else last,
        )
        self._check(rows, (_WHOLE, _WHOLE, _WHOLE, _NUMBER_OR_NULL, _WHOLE))
        (episodes, steps, cut_off, total, numbers) = rows[0]
        if not episodes:
            total = 0.0
        elif numbers < episodes or total is None:  # the sum of infinities of both signs is NaN
            total = math.nan
        return Totals(episodes, steps, cut_off, total)

    def checkpoint(self, trial_id: str) -> tuple[int, Checkpoint] | None:
        """Return the newest checkpoint of a trial and the episode after which it was taken, None if none."""
        rows = self._query(
            """SELECT episode, agent, environment FROM checkpoints
                WHERE trial = (SELECT key FROM trials WHERE id = ?)""",
            trial_id,
        )
        self._check(rows, (_WHOLE, _BYTES, _BYTES))
        return (rows[0][0], Checkpoint(*rows[0][1:])) if rows else None

    def checkpointed(self) -> dict[str, int]:
        """Return the episode after which the newest checkpoint was taken, for each trial that has one."""
        rows = self._query(
            """SELECT id, episode, (SELECT count(*) FROM episodes WHERE trial = key)
                FROM checkpoints JOIN trials ON key = trial"""
        )
        self._check(rows, (_TEXT, _WHOLE, _WHOLE))
        for trial_id, episode, done in rows:
            if not 0 < episode <= done:
                raise self._damaged(f"a checkpoint of {trial_id} follows episode {episode} of {done}")
        return {trial_id: episode for trial_id, episode, _ in rows}

    def voids(self) -> list[Void]:
        """Return the voided attempts, oldest first."""
        rows = self._query(
            "SELECT time, id, episode, why FROM voids JOIN trials ON key = trial ORDER BY voids.rowid"
        )
        self._check(rows, (_NUMBER, _TEXT, _WHOLE, _TEXT), timed=True)
        return [Void(*row) for row in rows]

    def events(self) -> list[Event]:
        """Return the events of the run, oldest first."""
        rows = self._query(
            "SELECT time, id, kind, text FROM events LEFT JOIN trials ON key = trial ORDER BY events.rowid"
        )
        self._check(rows, (_NUMBER, _TEXT_OR_NULL, _TEXT, _TEXT), timed=True)
        return [Event(*row) for row in rows]

    def answers(self, trial_id: str) -> list[Answered]:
        """Return what the agent of a trial answered after its episodes, in their order."""
        return self._answers("id = ? ORDER BY episode, message", trial_id)

    def newest_answers(self) -> list[Answered]:
        """Return what the agent of each trial answered last."""
        return self._answers(
            "episode = (SELECT max(episode) FROM answers WHERE trial = key) ORDER BY key, message"
        )

    def outcomes(self) -> dict[str, Outcome]:
        """Return how the trials of a competition ended, by id, for those that have."""
        rows = self._query("SELECT id, reason, digest FROM outcomes JOIN trials ON key = trial")
        self._check(rows, (_TEXT, _TEXT_OR_NULL, _BYTES))
        return {trial_id: Outcome(reason, digest) for trial_id, reason, digest in rows}

    def verdicts(self) -> dict[str, Verdict]:
        """Return the results of replaying trials of a competition, by id, as far as they were replayed."""
        rows = self._query("SELECT id, digest, problem, score FROM verdicts JOIN trials ON key = trial")
        self._check(rows, (_TEXT, _BYTES, _TEXT_OR_NULL, _NUMBER_OR_NULL))
        return {
            trial_id: Verdict(digest, problem, math.nan if score is None else score)
            for trial_id, digest, problem, score in rows
        }

    def _answers(self, which: str, *values: object) -> list[Answered]:
        rows = self._query(
            f"SELECT id, episode, message, answer FROM answers JOIN trials ON key = trial WHERE {which}",
            *values,
        )
        self._check(rows, (_TEXT, _WHOLE, _TEXT, _TEXT))
        return [Answered(*row) for row in rows]

    def _query(self, statement: str, *values: object) -> list[Any]:
        with reported(f"cannot read {self.directory}"):
            return self._database.query(statement, *values)

    def _check(
        self,
        rows: Sequence[Sequence[object]],
        types: Sequence[_Types],
        *,
        numbered: bool = False,
        timed: bool = False,
    ) -> None:
        """Check the types of each column, and whether the first counts from 1 or is a time, if it should."""
        columns: list[tuple[Any, ...]] = list(zip(*rows, strict=True))
        for column, allowed in zip(columns, types, strict=False):
            for found in set(map(type, column)).difference(allowed):
                raise self._damaged(f"a {found.__name__} where a {allowed[0].__name__} was expected")
        if not columns:
            return
        if numbered and columns[0] != tuple(range(1, len(rows) + 1)):
            raise self._damaged("episodes of a trial are missing")
        if timed and not (min(columns[0]) >= 0 and max(columns[0]) <= _LAST_SECOND):
            raise self._damaged("a time out of range")

    def _trial(
        self,
        trial_id: str,
        agent: str | None,
        environment: str | None,
        episodes: int,
        max_steps: int,
        seed: int,
        done: int,
        voids: int,
        failure: str | None,
    ) -> TrialRecord:
        for name, value in (("episodes", episodes), ("max_steps", max_steps), ("seed", seed)):
            if value not in COUNTS[name]:
                raise self._damaged(f"{value} for the {name} of {trial_id}")
        roles = (self._role(trial_id, agent), self._role(trial_id, environment))
        return TrialRecord(TrialSpec(trial_id, *roles, episodes, max_steps, seed), done, voids, failure)

    def _role(self, trial_id: str, text: str | None) -> RoleSpec | None:
        if text is None:
            return None
        try:
            match json.loads(text):
                case {"name": str(name), "options": dict(options), "label": str(label)} if _are_values(
                    options.values()
                ):
                    return RoleSpec(name, options, label)
        except (ValueError, RecursionError):
            pass
        raise self._damaged(f"the agent or environment of {trial_id} cannot be read")

    def _damaged(self, what: str) -> ExperimentError:
        return ExperimentError(f"cannot read {self.directory}: results.sqlite is damaged: {what}")


def _are_values(values: Collection[object]) -> bool:
    return all(
        isinstance(value, (float, str)) or (isinstance(value, int) and -(2**63) <= value < 2**63)
        for value in values
    )
