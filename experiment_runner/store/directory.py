"""What an experiment leaves behind: a run directory.

    plan.toml        the plan, resolved; `glue-experiment --plan` reads it
    run.json         code version, packages, machine
    results.sqlite   trials, episodes, voids, events, checkpoints
    lock             held by the one process that writes

A `Store` writes, and only one at a time can; `Results` reads, at any time, also while a run goes
on. An episode is committed before `Store.record` returns, together with the checkpoint that
follows it, so whatever moment a process is killed at, the database holds whole episodes, and a
checkpoint never knows of an episode that the database lacks.

A commit outlives every process, whatever kills them. It reaches the medium with the next
checkpoint at the latest, so if the machine itself loses power, the newest episodes back to that
checkpoint may be missing, as if they had not been run; nothing is damaged, and resuming runs them
again to the same numbers. (A commit takes some 20 microseconds so; flushing each to the medium
takes six times that on a fast virtual disk, and far more on a spinning one.)
"""

from __future__ import annotations

import json
import os
import sqlite3
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Final, NamedTuple, Self

import numpy as np
import numpy.typing as npt

from experiment_runner.plan import RoleSpec, TrialSpec
from experiment_runner.store.database import (
    DATABASE_FILES,
    connect_to_read,
    connect_to_write,
    holds_run,
    migrate,
    reported,
    transaction,
)
from experiment_runner.store.lock import LOCK_FILE, RunLock
from glue.errors import ExperimentError

__all__ = [
    "ABOUT_FILE",
    "PLAN_FILE",
    "Checkpoint",
    "EpisodeResult",
    "Event",
    "Results",
    "Store",
    "Totals",
    "TrialRecord",
    "Void",
]

PLAN_FILE: Final = "plan.toml"
ABOUT_FILE: Final = "run.json"

_OURS: Final = (PLAN_FILE, ABOUT_FILE, *DATABASE_FILES)

_PUT_EPISODE: Final = "INSERT INTO episodes VALUES (?, ?, ?, ?, ?, ?)"
_PUT_CHECKPOINT: Final = "REPLACE INTO checkpoints VALUES (?, ?, ?, ?)"
_PUT_VOID: Final = "INSERT INTO voids VALUES (?, ?, ?, ?)"
_PUT_EVENT: Final = "INSERT INTO events VALUES (?, ?, ?, ?)"


class EpisodeResult(NamedTuple):
    """One finished episode.

    episode         counts from 1 in each trial
    episode_return  undiscounted sum of the rewards
    steps           as RL_num_steps
    terminal        False when it was cut off by the step limit
    wall_time       seconds
    """

    episode: int
    episode_return: float
    steps: int
    terminal: bool
    wall_time: float


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """What a trial continues from: the bytes of `agent_save` and `env_save`, empty where there is none."""

    agent: bytes
    environment: bytes = b""


class TrialRecord(NamedTuple):
    """How far a trial is: episodes recorded, episodes voided, and why it failed if it did."""

    spec: TrialSpec
    done: int
    voids: int
    failure: str | None

    @property
    def finished(self) -> bool:
        return self.done == self.spec.episodes


class Totals(NamedTuple):
    """The last episodes of a trial, or all, taken together.

    episodes         how many
    steps            of all of them
    cut_off          how many were cut off
    sum_of_returns   0.0 when there are none, NaN when one is
    """

    episodes: int
    steps: int
    cut_off: int
    sum_of_returns: float


class Void(NamedTuple):
    """An attempt at an episode that does not count, as when a peer was lost. Time: seconds since 1970."""

    time: float
    trial_id: str
    episode: int
    why: str


class Event(NamedTuple):
    """Something that happened to a run, or to one of its trials. Time: seconds since 1970."""

    time: float
    trial_id: str | None
    kind: str
    text: str


class Results:
    """Reads a run directory, also while it is written to. Use as a context, or `close` it."""

    def __init__(self, directory: Path, connection: sqlite3.Connection) -> None:
        self.directory = directory
        self._connection = connection

    @classmethod
    def open(cls, directory: Path) -> Self:
        """Return the results in a run directory, for reading.

        Raises:
            ExperimentError: there is no run, or it cannot be read.
        """
        with reported(f"cannot read {directory}"):
            return cls(directory, connect_to_read(directory))

    def close(self) -> None:
        """Let go of the files."""
        self._connection.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def trials(self) -> list[TrialRecord]:
        """Return how far every trial is, in the order of the plan."""
        rows = self._query(
            """SELECT id, agent, environment, episodes, max_steps, seed,
                (SELECT count(*) FROM episodes WHERE trial = key),
                (SELECT count(*) FROM voids WHERE trial = key),
                failure FROM trials ORDER BY key"""
        )
        return [
            TrialRecord(TrialSpec(row[0], _role(row[1]), _role(row[2]), *row[3:6]), *row[6:]) for row in rows
        ]

    def episodes(self, trial_id: str) -> list[EpisodeResult]:
        """Return the episodes of a trial so far, in order; a return that is not a number is NaN."""
        rows = self._query(
            """SELECT episode, episode_return, steps, terminal, wall_time FROM episodes
                WHERE trial = (SELECT key FROM trials WHERE id = ?) ORDER BY episode""",
            trial_id,
        )
        return [
            EpisodeResult(episode, np.nan if total is None else total, steps, bool(terminal), wall_time)
            for episode, total, steps, terminal, wall_time in rows
        ]

    def returns(self, trial_id: str) -> npt.NDArray[np.float64]:
        """Return the episode returns of a trial so far, shape (episodes,)."""
        rows = self._query(
            """SELECT episode_return FROM episodes
                WHERE trial = (SELECT key FROM trials WHERE id = ?) ORDER BY episode""",
            trial_id,
        )
        return np.array([np.nan if total is None else total for (total,) in rows], np.float64)

    def totals(self, trial_id: str, last: int | None = None) -> Totals:
        """Return what the episodes of a trial so far, or the last few, come to; however many they are."""
        (episodes, steps, cut_off, total, numbers) = self._query(
            """SELECT count(*), ifnull(sum(steps), 0), ifnull(sum(NOT terminal), 0),
                sum(episode_return), count(episode_return) FROM
                (SELECT * FROM episodes WHERE trial = (SELECT key FROM trials WHERE id = ?)
                ORDER BY episode DESC LIMIT ?)""",
            trial_id,
            -1 if last is None else last,
        )[0]
        if not episodes:
            total = 0.0
        elif numbers < episodes or total is None:  # infinities of both signs have no sum
            total = np.nan
        return Totals(episodes, steps, cut_off, total)

    def checkpoint(self, trial_id: str) -> tuple[int, Checkpoint] | None:
        """Return the newest checkpoint of a trial and the episode it follows."""
        rows = self._query(
            """SELECT episode, agent, environment FROM checkpoints
                WHERE trial = (SELECT key FROM trials WHERE id = ?)""",
            trial_id,
        )
        return (rows[0][0], Checkpoint(*rows[0][1:])) if rows else None

    def checkpointed(self) -> dict[str, int]:
        """Return which trials have a checkpoint, and the episode it follows."""
        return dict(self._query("SELECT id, episode FROM checkpoints JOIN trials ON key = trial"))

    def voids(self) -> list[Void]:
        """Return the voided attempts, oldest first."""
        rows = self._query(
            "SELECT time, id, episode, why FROM voids JOIN trials ON key = trial ORDER BY voids.rowid"
        )
        return [Void(*row) for row in rows]

    def events(self) -> list[Event]:
        """Return what happened to the run, oldest first."""
        rows = self._query(
            "SELECT time, id, kind, text FROM events LEFT JOIN trials ON key = trial ORDER BY events.rowid"
        )
        return [Event(*row) for row in rows]

    def _query(self, statement: str, *values: object) -> list[Any]:
        with reported(f"cannot read {self.directory}"):
            return self._connection.execute(statement, values).fetchall()


class Store(Results):
    """Writes a run directory, and reads it. One at a time, of all processes; see the top of this module."""

    def __init__(
        self, directory: Path, connection: sqlite3.Connection, lock: RunLock, clock: Callable[[], float]
    ) -> None:
        super().__init__(directory, connection)
        self._lock = lock
        self._clock = clock
        self._keys: dict[str, int] = dict(self._query("SELECT id, key FROM trials"))
        self._done = {record.spec.id: record.done for record in self.trials()}

    @classmethod
    def create(
        cls,
        directory: Path,
        trials: Sequence[TrialSpec],
        files: Mapping[str, str],
        *,
        clock: Callable[[], float] = time.time,
    ) -> Self:
        """Make a run directory.

        Args:
            directory: is made, with its parents; if it exists, it is empty.
            trials: every trial of the run.
            files: texts to put beside the database, by name (`PLAN_FILE`, `ABOUT_FILE`).
            clock: returns seconds since 1970.

        Raises:
            ExperimentError: the directory holds a run or anything else, is in use, or cannot be
                written to. Nothing of the run is left behind.
        """
        with reported(f"cannot make {directory}"):
            made = not directory.exists()
            directory.mkdir(parents=True, exist_ok=True)
            for path in directory.iterdir():
                if path.name not in (*_OURS, LOCK_FILE):
                    raise ExperimentError(
                        f"{directory} holds {path.name}, which is not of a run: "
                        "choose another directory with --out"
                    )
            lock = RunLock(directory)
            try:
                if holds_run(directory):
                    raise ExperimentError(
                        f"{directory} holds a run: continue it with --resume {directory}, "
                        "or choose another directory with --out"
                    )
                return cls._create(directory, trials, files, lock, clock, made)
            except BaseException:
                lock.release()
                raise

    @classmethod
    def _create(
        cls,
        directory: Path,
        trials: Sequence[TrialSpec],
        files: Mapping[str, str],
        lock: RunLock,
        clock: Callable[[], float],
        made: bool,
    ) -> Self:
        connection = None
        try:
            for name, text in files.items():
                _write_flushed(directory / name, text)
            connection = connect_to_write(directory)
            # The run exists from the moment that this transaction, the last thing done, commits.
            with transaction(connection):
                migrate(connection)
                connection.executemany(
                    """INSERT INTO trials (id, agent, environment, episodes, max_steps, seed)
                        VALUES (?, ?, ?, ?, ?, ?)""",
                    (
                        (
                            t.id,
                            _role_text(t.agent),
                            _role_text(t.environment),
                            t.episodes,
                            t.max_steps,
                            t.seed,
                        )
                        for t in trials
                    ),
                )
            return cls(directory, connection, lock, clock)
        except BaseException:
            if connection is not None:
                connection.close()
            for name in _OURS:
                (directory / name).unlink(missing_ok=True)
            if made:
                (directory / LOCK_FILE).unlink(missing_ok=True)
                directory.rmdir()
            raise

    @classmethod
    def open(cls, directory: Path, *, clock: Callable[[], float] = time.time) -> Self:
        """Return the store of a run that exists, to go on with it.

        Raises:
            ExperimentError: there is no run, another process writes to it, or it cannot be written to.
        """
        with reported(f"cannot open {directory}"):
            if not holds_run(directory):
                raise ExperimentError(f"{directory} holds no run")
            lock = RunLock(directory)
            connection = None
            try:
                connection = connect_to_write(directory)
                with transaction(connection):
                    migrate(connection)
                return cls(directory, connection, lock, clock)
            except BaseException:
                if connection is not None:
                    connection.close()
                lock.release()
                raise

    def close(self) -> None:
        """Let go of the files, and of the lock."""
        super().close()
        self._lock.release()

    def record(self, trial_id: str, result: EpisodeResult, checkpoint: Checkpoint | None = None) -> None:
        """Commit a finished episode, and the checkpoint that follows it.

        Raises:
            ExperimentError: it is not the trial's next episode, or cannot be written. Then it is not
                recorded, and everything before it is.
        """
        key = self._key(trial_id)
        expected = self._done[trial_id] + 1
        if result.episode != expected:
            raise ExperimentError(
                f"episode {result.episode} of {trial_id} came where episode {expected} was expected"
            )
        # With a checkpoint, flush: a loss of power then never costs more than the episodes since.
        self._execute(f"PRAGMA synchronous = {'NORMAL' if checkpoint is None else 'FULL'}")
        with (
            reported(
                f"episode {result.episode} of {trial_id} is not recorded",
                f"; the episodes before it are. Mend that, and continue with --resume {self.directory}",
            ),
            transaction(self._connection),
        ):
            self._connection.execute(_PUT_EPISODE, (key, *result))
            if checkpoint is not None:
                row = (key, result.episode, checkpoint.agent, checkpoint.environment)
                self._connection.execute(_PUT_CHECKPOINT, row)
        self._done[trial_id] = result.episode

    def record_void(self, trial_id: str, episode: int, why: str) -> None:
        """Commit that an attempt at an episode does not count."""
        self._execute(
            "INSERT INTO voids VALUES (?, ?, ?, ?)", self._clock(), self._key(trial_id), episode, why
        )

    def record_event(self, kind: str, text: str, trial_id: str | None = None) -> None:
        """Commit that something happened; `kind` is one word, `text` is for people."""
        key = None if trial_id is None else self._key(trial_id)
        self._execute(_PUT_EVENT, self._clock(), key, kind, text)

    def record_failure(self, trial_id: str, why: str) -> None:
        """Commit that a trial cannot go on; its episodes stay."""
        self._execute("UPDATE trials SET failure = ? WHERE key = ?", why, self._key(trial_id))

    def rewind(self, trial_id: str, episode: int) -> None:
        """Forget what a trial did after an episode, 0 for all, and that it failed; for it to go on there.

        Raises:
            ExperimentError: it cannot be written.
        """
        key = self._key(trial_id)
        with reported(f"cannot write to {self.directory}"), transaction(self._connection):
            self._connection.execute("DELETE FROM episodes WHERE trial = ? AND episode > ?", (key, episode))
            self._connection.execute(
                "DELETE FROM checkpoints WHERE trial = ? AND episode > ?", (key, episode)
            )
            self._connection.execute("UPDATE trials SET failure = NULL WHERE key = ?", (key,))
        self._done[trial_id] = min(self._done[trial_id], episode)

    def adopt(self, results: Results, trial_id: str, as_id: str) -> None:
        """Copy everything that another run recorded of a trial into a trial of this one that is empty.

        Raises:
            ExperimentError: it cannot be read or written; then nothing of it is copied.
        """
        key = self._key(as_id)
        failures = [record.failure for record in results.trials() if record.spec.id == trial_id]
        # Before the episodes: in a run under way it must not know of one that is not copied.
        checkpoint = results.checkpoint(trial_id)
        episodes = results.episodes(trial_id)
        voids = [void for void in results.voids() if void.trial_id == trial_id]
        events = [event for event in results.events() if event.trial_id == trial_id]
        write = self._connection.executemany
        with reported(f"cannot write to {self.directory}"), transaction(self._connection):
            write("UPDATE trials SET failure = ? WHERE key = ?", ((why, key) for why in failures))
            write(_PUT_EPISODE, ((key, *e) for e in episodes))
            if checkpoint is not None:
                episode, saved = checkpoint
                write(_PUT_CHECKPOINT, [(key, episode, saved.agent, saved.environment)])
            write(_PUT_VOID, ((v.time, key, v.episode, v.why) for v in voids))
            write(_PUT_EVENT, ((e.time, key, e.kind, e.text) for e in events))
        self._done[as_id] = len(episodes)

    def done(self, trial_id: str) -> int:
        """Return how many episodes of a trial are recorded."""
        self._key(trial_id)
        return self._done[trial_id]

    def _key(self, trial_id: str) -> int:
        if trial_id not in self._keys:
            raise ExperimentError(f"{self.directory} has no trial {trial_id}")
        return self._keys[trial_id]

    def _execute(self, statement: str, *values: object) -> None:
        with reported(f"cannot write to {self.directory}"):
            self._connection.execute(statement, values)


def _role_text(role: RoleSpec | None) -> str | None:
    if role is None:
        return None
    return json.dumps({"name": role.name, "options": dict(role.options), "label": role.label})


def _role(text: str | None) -> RoleSpec | None:
    return None if text is None else RoleSpec(**json.loads(text))


def _write_flushed(path: Path, text: str) -> None:
    with path.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())
