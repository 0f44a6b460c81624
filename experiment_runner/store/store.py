"""Writing a run directory.

An episode and the checkpoint taken after it are committed in one transaction; `Store.record_all` commits
several. So whenever a process is killed, the database contains whole episodes, and every episode that a
checkpoint includes.

A commit survives the process, however it ends. It is flushed to the disk with the next checkpoint at the
latest: if the machine loses power, the episodes since the last checkpoint may be lost, as if they had not
been run. Nothing is damaged, and a resumed run repeats them with the same results. (A commit takes some
20 microseconds; flushing each one would take six times that on a fast virtual disk, and far more on a
spinning one.)
"""

from __future__ import annotations

import contextlib
import json
import os
import sqlite3
from collections import defaultdict
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from time import time
from typing import Final, Self

from experiment_runner.plan.plan import RoleSpec, TrialSpec
from experiment_runner.store.database import (
    DATABASE_FILES,
    KEPT,
    Database,
    holds_run,
    open_to_write,
    reported,
    transaction,
)
from experiment_runner.store.layout import RunLock, check_links, new_run, write_flushed
from experiment_runner.store.readings import Block
from experiment_runner.store.records import (
    Answer,
    Checkpoint,
    EpisodeResult,
    OutsidePlayer,
    Reading,
    ReplayVerdict,
    TrialEnd,
)
from experiment_runner.store.results import Results
from glue.errors import ExperimentError
from glue.files import open_regular

_PUT_TRIAL: Final = """INSERT INTO trials
    (id, agent, environment, episodes, max_steps, seed, steps, rate, late, delay)
    VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?)"""
_PUT_EPISODE: Final = f"INSERT INTO episodes VALUES (?{', ?' * len(EpisodeResult._fields)})"
_PUT_ANSWER: Final = "INSERT INTO answers VALUES (?, ?, ?, ?)"
_PUT_READINGS: Final = "INSERT INTO readings VALUES (?, ?, ?, ?)"
_PUT_CHECKPOINT: Final = "REPLACE INTO checkpoints VALUES (?, ?, ?, ?, ?)"
_PUT_VOID: Final = "INSERT INTO voids VALUES (?, ?, ?, ?)"
_PUT_OUTCOME: Final = "REPLACE INTO outcomes VALUES (?, ?, ?)"
_PUT_VERDICT: Final = "REPLACE INTO verdicts VALUES (?, ?, ?, ?)"
_PUT_PLAYER: Final = "INSERT INTO players VALUES (?, ?, ?, ?, ?)"
_PUT_EVENT: Final = "INSERT INTO events VALUES (?, ?, ?, ?)"

_TABLES: Final = (
    *("answers", "checkpoints", "episodes", "events", "outcomes", "players", "readings", "verdicts", "voids"),
)
"""Tables whose rows belong to a trial."""

_Record = tuple[str, EpisodeResult, Checkpoint | None, tuple[Answer, ...], tuple[Reading, ...]]


class Store(Results):
    """Writes and reads a run directory, one process at a time; see the top of this module."""

    def __init__(self, directory: Path, database: Database, lock: RunLock) -> None:
        super().__init__(directory, database)
        self._connection = database.connection
        self._lock = lock
        self._flushing: bool | None = None  # not known yet
        self._keys: dict[str, int] = dict(self._query("SELECT id, key FROM trials"))
        self._names: dict[str, int] = dict(self._query("SELECT names, key FROM metric_names"))
        self._done: dict[str, int] = {record.spec.id: record.done for record in self.trials()}

    @classmethod
    def create(
        cls,
        directory: Path,
        trials: Sequence[TrialSpec],
        files: Mapping[str, str | bytes],
        *,
        fill: Callable[[Self], None] | None = None,
    ) -> Self:
        """Create a run directory.

        Args:
            directory: created with its parents; if it exists, it must be empty.
            trials: every trial of the run.
            files: the contents of the other files, by name (`PLAN_FILE`, `ABOUT_FILE`), in the directory or a
                subfolder of it.
            fill: writes the initial records; the run exists only after it has returned.

        Raises:
            ExperimentError: the directory is not empty, is in use, or cannot be written to. It is then left
                as it was.
        """
        with reported(f"cannot make {directory}"):
            with new_run(directory) as (folder, lock):
                for name, content in files.items():
                    write_flushed(folder / name, content)
                with contextlib.closing(open_to_write(folder)) as database:
                    with transaction(database.connection):
                        database.connection.executemany(_PUT_TRIAL, map(_trial_row, trials))
                    if fill is not None:
                        fill(cls(folder, database, lock))
            return cls._open(directory, lock)

    @classmethod
    def open(cls, directory: Path) -> Self:
        """Open an existing run, to continue it.

        Raises:
            ExperimentError: there is no run, another process has its lock, or it cannot be written to.
        """
        with reported(f"cannot open {directory}"):
            if not holds_run(directory):
                raise ExperimentError(f"{directory} holds no run")
            check_links(directory)
            return cls._open(directory, RunLock(directory))

    @classmethod
    def _open(cls, directory: Path, lock: RunLock) -> Self:
        with contextlib.ExitStack() as failed:
            failed.callback(lock.release)
            store = cls(directory, failed.enter_context(contextlib.closing(open_to_write(directory))), lock)
            failed.pop_all()
        return store

    def close(self) -> None:
        """Close the files, and release the lock."""
        super().close()
        self._lock.release()

    def record(self, trial_id: str, result: EpisodeResult, checkpoint: Checkpoint | None = None) -> None:
        """Commit a finished episode, and the checkpoint taken after it.

        Raises:
            ExperimentError: it is not the trial's next episode, or cannot be written. The episodes before
                it remain recorded.
        """
        self.record_all([(trial_id, result, checkpoint, (), ())])

    def record_all(self, records: Sequence[_Record]) -> None:
        """Commit finished episodes of one trial or several, all of them or none, each with the agent's
        answers after it, and its metrics; see `record`.
        """
        done: dict[str, int] = {}
        episodes: list[tuple[object, ...]] = []
        answered: list[tuple[object, ...]] = []
        saved: list[tuple[object, ...]] = []
        blocks: dict[tuple[int, int], Block] = defaultdict(Block)  # none extends beyond a checkpoint
        for trial_id, result, checkpoint, answers, readings in records:
            key, number = self._key(trial_id), result.episode
            expected = done.get(trial_id, self._done[trial_id]) + 1
            if number != expected:
                raise ExperimentError(
                    f"episode {number} of {trial_id} was recorded where episode {expected} was expected"
                )
            done[trial_id] = expected
            episodes.append((key, *result))
            answered += [(key, number, *answer) for answer in answers]
            if readings:
                blocks[key, len(saved)].add(number, readings)
            if checkpoint is not None:
                saved.append(_checkpoint_row(key, number, checkpoint))
        read = [
            (key, block.episode, self._key_of(names), data)
            for (key, _), block in blocks.items()
            for names, data in block.data().items()
        ]
        # Flush with each checkpoint: then a power loss costs at most the episodes since.
        self._flush_commits(bool(saved))
        with (
            reported(
                _unrecorded(records),
                f"; the episodes before it are. Solve that, and resume the run in {self.directory}",
                settings=("resume",),
            ),
            transaction(self._connection),
        ):
            write = self._connection.executemany
            write(_PUT_EPISODE, episodes)
            write(_PUT_ANSWER, answered)
            write(_PUT_READINGS, read)
            write(_PUT_CHECKPOINT, saved)
        self._done.update(done)

    def _key_of(self, names: str) -> int:
        """Return the key of the names of metrics, one on each line; new ones are stored."""
        if names not in self._names:
            self._execute("INSERT INTO metric_names (names) VALUES (?)", names)
            self._names.update(self._query("SELECT names, key FROM metric_names"))
        return self._names[names]

    def extend(self, trials: Sequence[TrialSpec]) -> None:
        """Commit the trials of a longer plan: new ones are added, the others get the plan's length."""
        added: dict[str, int] = {}
        with self._writing(), transaction(self._connection):
            for spec in trials:
                if spec.id in self._keys:
                    self._connection.execute(
                        "UPDATE trials SET episodes = ?, steps = ? WHERE key = ?",
                        (spec.episodes, spec.steps, self._keys[spec.id]),
                    )
                else:
                    self._connection.execute(_PUT_TRIAL, _trial_row(spec))
                    ((added[spec.id],),) = self._query("SELECT last_insert_rowid()")
        self._keys |= added
        self._done |= dict.fromkeys(added, 0)

    def record_void(self, trial_id: str, episode: int, why: str) -> None:
        """Commit that an attempt at an episode does not count."""
        self._execute(_PUT_VOID, time(), self._key(trial_id), episode, why)

    def record_event(self, kind: str, text: str, trial_id: str | None = None) -> None:
        """Commit an event; `kind` is one word, `text` a readable sentence."""
        key = None if trial_id is None else self._key(trial_id)
        self._execute(_PUT_EVENT, time(), key, kind, text)

    def record_once(self, kind: str, text: str) -> bool:
        """Commit an event of the run unless it has the same already; return whether it is new."""
        new = all((event.kind, event.text) != (kind, text) for event in self.events())
        if new:
            self.record_event(kind, text)
        return new

    def record_player(self, trial_id: str, role: str, name: str, program: str | None) -> OutsidePlayer:
        """Commit, also as an event, that a player joined a trial from outside; return its record."""
        player = OutsidePlayer(time(), trial_id, role, name, program)
        self._execute(_PUT_PLAYER, player.time, self._key(trial_id), role, name, program)
        self.record_event("joined", f"{player} joined", trial_id)
        return player

    def record_failure(self, trial_id: str, why: str) -> None:
        """Commit that a trial has failed; its episodes are kept."""
        self._execute("UPDATE trials SET failure = ? WHERE key = ?", why, self._key(trial_id))

    def record_outcome(self, trial_id: str, outcome: TrialEnd) -> None:
        """Commit how a trial of a competition ended, and flush everything about it to the disk."""
        self._flush_commits(True)
        self._execute(_PUT_OUTCOME, self._key(trial_id), *outcome)

    def record_verdict(self, trial_id: str, verdict: ReplayVerdict) -> None:
        """Commit the result of replaying a trial, in place of an earlier one."""
        self._execute(_PUT_VERDICT, self._key(trial_id), *verdict)

    def rewind(self, trial_id: str, episode: int) -> None:
        """Delete everything after a checkpoint of a trial, and its outcome, to repeat it.

        Args:
            trial_id: of the trial.
            episode: episode of the checkpoint; 0 to delete all of the trial's episodes.

        Raises:
            ExperimentError: the database cannot be written to.
        """
        key = self._key(trial_id)
        with self._writing(), transaction(self._connection):
            for table in ("episodes", "answers", "readings", "checkpoints"):
                self._connection.execute(
                    f"DELETE FROM {table} WHERE trial = ? AND episode > ?", (key, episode)
                )
            self._connection.execute("UPDATE trials SET failure = NULL WHERE key = ?", (key,))
            for table in ("outcomes", "verdicts"):
                self._connection.execute(f"DELETE FROM {table} WHERE trial = ?", (key,))
        self._done[trial_id] = min(self._done[trial_id], episode)

    def adopt(self, results: Results, trial_id: str, as_id: str) -> None:
        """Copy all records of a trial of another run to a trial of this run, replacing its own.

        They are flushed to the disk: the other run may be removed then.

        Raises:
            ExperimentError: they cannot be read or written; then nothing is copied.
        """
        key = self._key(as_id)
        failures = [record.failure for record in results.trials() if record.spec.id == trial_id]
        # Before the episodes: in a run under way, it must not include an episode that is not copied.
        checkpoint = results.checkpoint(trial_id)
        episodes = results.episodes(trial_id)
        answers = [answered for answered in results.answers(trial_id) if answered.episode <= len(episodes)]
        readings = [
            (key, episode, self._key_of(names), data)
            for episode, names, data in results.readings(trial_id)
            if episode <= len(episodes)
        ]
        voids = [void for void in results.voids() if void.trial_id == trial_id]
        events = [event for event in results.events() if event.trial_id == trial_id]
        players = [player for player in results.players() if player.trial_id == trial_id]
        outcome, verdict = results.outcomes().get(trial_id), results.verdicts().get(trial_id)
        write = self._connection.executemany
        self._flush_commits(True)
        with self._writing(), transaction(self._connection):
            for table in _TABLES:
                self._connection.execute(f"DELETE FROM {table} WHERE trial = ?", (key,))
            write("UPDATE trials SET failure = ? WHERE key = ?", ((why, key) for why in failures))
            write(_PUT_EPISODE, ((key, *e) for e in episodes))
            write(_PUT_ANSWER, ((key, a.episode, a.message, a.answer) for a in answers))
            write(_PUT_READINGS, readings)
            if checkpoint is not None:
                episode, saved = checkpoint
                write(_PUT_CHECKPOINT, [_checkpoint_row(key, episode, saved)])
            write(_PUT_VOID, ((v.time, key, v.episode, v.why) for v in voids))
            write(_PUT_EVENT, ((e.time, key, e.kind, e.text) for e in events))
            write(_PUT_PLAYER, ((p.time, key, p.role, p.name, p.program) for p in players))
            write(_PUT_OUTCOME, [(key, *outcome)] if outcome else [])
            write(_PUT_VERDICT, [(key, *verdict)] if verdict else [])
        self._done[as_id] = len(episodes)

    def copy_to(self, folder: Path) -> None:
        """Write a copy of the database, flushed to the disk, into a folder that has none.

        Raises:
            ExperimentError: it cannot be written.
        """
        path = folder / DATABASE_FILES[0]
        with reported(f"cannot write {path}"):
            with contextlib.closing(sqlite3.connect(path)) as copy:
                self._connection.backup(copy)
            with open_regular(path) as file:
                os.fsync(file.fileno())

    def done(self, trial_id: str) -> int:
        """Return the number of recorded episodes of a trial."""
        self._key(trial_id)
        return self._done[trial_id]

    def _key(self, trial_id: str) -> int:
        if trial_id not in self._keys:
            raise ExperimentError(f"{self.directory} has no trial {trial_id}")
        return self._keys[trial_id]

    def _flush_commits(self, wanted: bool) -> None:
        """Set whether commits are flushed to the disk."""
        if wanted is not self._flushing:
            self._execute(f"PRAGMA synchronous = {'FULL' if wanted else 'NORMAL'}")
            self._flushing = wanted

    def _writing(self) -> AbstractContextManager[None]:
        return reported(f"cannot write to {self.directory}", KEPT)

    def _execute(self, statement: str, *values: object) -> None:
        with self._writing():
            self._connection.execute(statement, values)


def _unrecorded(records: Sequence[_Record]) -> str:
    trial_id, result, *_ = records[0]
    first = f"episode {result.episode} of {trial_id} is not recorded"
    return first if len(records) == 1 else f"{first}, nor are {len(records) - 1} after it"


def _trial_row(spec: TrialSpec) -> tuple[object, ...]:
    roles = (_role_text(spec.agent), _role_text(spec.environment))
    pace = (spec.pace.rate, spec.pace.late, spec.pace.delay)
    return (spec.id, *roles, spec.episodes, spec.max_steps, spec.seed, spec.steps, *pace)


def _checkpoint_row(key: int, episode: int, saved: Checkpoint) -> tuple[object, ...]:
    return key, episode, saved.agent, saved.environment, saved.metrics


def _role_text(role: RoleSpec | None) -> str | None:
    if role is None:
        return None
    return json.dumps({"name": role.name, "options": dict(role.options), "label": role.label})
