"""Writing a run directory.

An episode and the checkpoint taken after it are committed in one transaction; `Store.record_all` commits
several. So the database contains whole episodes at whatever moment a process is killed, and every episode
that a checkpoint includes.

A commit survives the process, however it ends. It is flushed to the disk with the next checkpoint at the
latest: if the machine loses power, the episodes since the last checkpoint may be lost, as if they had not
been run. Nothing is damaged, and a resumed run repeats them with the same results. (A commit takes some
20 microseconds; flushing each one would take six times that on a fast virtual disk, and far more on a
spinning one.)
"""

from __future__ import annotations

import contextlib
import itertools
import json
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Final, Self

from experiment_runner.plan.plan import RoleSpec, TrialSpec
from experiment_runner.store.database import KEPT, Database, holds_run, open_to_write, reported, transaction
from experiment_runner.store.layout import new_run, write_flushed
from experiment_runner.store.lock import RunLock
from experiment_runner.store.records import (
    Answer,
    Checkpoint,
    EpisodeResult,
    Outcome,
    Player,
    Reading,
    Verdict,
)
from experiment_runner.store.results import Results, thinned
from glue.errors import ExperimentError

_PUT_TRIAL: Final = """INSERT INTO trials (id, agent, environment, episodes, max_steps, seed, steps)
    VALUES (?, ?, ?, ?, ?, ?, ?)"""
_PUT_EPISODE: Final = f"INSERT INTO episodes VALUES (?{', ?' * len(EpisodeResult._fields)})"
_PUT_ANSWER: Final = "INSERT INTO answers VALUES (?, ?, ?, ?)"
_PUT_METRIC: Final = "INSERT INTO metrics VALUES (?, ?, ?, ?, ?, ?, ?, ?)"
_PUT_CHECKPOINT: Final = "REPLACE INTO checkpoints VALUES (?, ?, ?, ?)"
_PUT_VOID: Final = "INSERT INTO voids VALUES (?, ?, ?, ?)"
_PUT_OUTCOME: Final = "REPLACE INTO outcomes VALUES (?, ?, ?)"
_PUT_VERDICT: Final = "REPLACE INTO verdicts VALUES (?, ?, ?, ?)"
_PUT_PLAYER: Final = "INSERT INTO players VALUES (?, ?, ?, ?, ?)"
_PUT_EVENT: Final = "INSERT INTO events VALUES (?, ?, ?, ?)"

_TABLES: Final = (
    *("answers", "checkpoints", "episodes", "events", "metrics", "outcomes", "players", "verdicts", "voids"),
)
"""Tables whose rows belong to a trial."""

_Record = tuple[str, EpisodeResult, Checkpoint | None, tuple[Answer, ...], tuple[Reading, ...]]


class Store(Results):
    """Writes and reads a run directory, one process at a time; see the top of this module."""

    def __init__(
        self, directory: Path, database: Database, lock: RunLock, clock: Callable[[], float]
    ) -> None:
        super().__init__(directory, database)
        self._connection = database.connection
        self._lock = lock
        self._clock = clock
        self._flushing: bool | None = None  # not known yet
        self._keys: dict[str, int] = dict(self._query("SELECT id, key FROM trials"))
        self._done: dict[str, int] = {record.spec.id: record.done for record in self.trials()}

    @classmethod
    def create(
        cls,
        directory: Path,
        trials: Sequence[TrialSpec],
        files: Mapping[str, str | bytes],
        *,
        fill: Callable[[Self], None] | None = None,
        clock: Callable[[], float] = time.time,
    ) -> Self:
        """Create a run directory.

        Args:
            directory: created with its parents; if it exists, it must be empty.
            trials: every trial of the run.
            files: the contents of the other files, by name (`PLAN_FILE`, `ABOUT_FILE`), in the directory or a
                subfolder of it.
            fill: writes the initial records; the run exists only after it has returned.
            clock: returns seconds since 1970.

        Raises:
            ExperimentError: the directory is not empty, is in use, or cannot be written to. Then it is
                as it was before.
        """
        with reported(f"cannot make {directory}"):
            with new_run(directory) as made:
                for name, content in files.items():
                    write_flushed(made.folder / name, content)
                with contextlib.closing(open_to_write(made.folder)) as database:
                    with transaction(database.connection):
                        database.connection.executemany(_PUT_TRIAL, map(_trial_row, trials))
                    if fill is not None:
                        fill(cls(made.folder, database, made.lock, clock))
            return cls._open(directory, made.lock, clock)

    @classmethod
    def open(cls, directory: Path, *, clock: Callable[[], float] = time.time) -> Self:
        """Open an existing run, to continue it.

        Raises:
            ExperimentError: there is no run, another process has its lock, or it cannot be written to.
        """
        with reported(f"cannot open {directory}"):
            if not holds_run(directory):
                raise ExperimentError(f"{directory} holds no run")
            return cls._open(directory, RunLock(directory), clock)

    @classmethod
    def _open(cls, directory: Path, lock: RunLock, clock: Callable[[], float]) -> Self:
        database = None
        try:
            database = open_to_write(directory)
            return cls(directory, database, lock, clock)
        except BaseException:
            if database is not None:
                database.close()
            lock.release()
            raise

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
        """Commit finished episodes, of one trial or of several, all of them or none; as `record`, each with
        what the agent answered after it, and its metrics.
        """
        done: dict[str, int] = {}
        for trial_id, result, *_ in records:
            self._key(trial_id)
            expected = done.get(trial_id, self._done[trial_id]) + 1
            if result.episode != expected:
                raise ExperimentError(
                    f"episode {result.episode} of {trial_id} was recorded "
                    f"where episode {expected} was expected"
                )
            done[trial_id] = expected
        # Flush with each checkpoint: then a power loss costs at most the episodes since.
        self._flush_commits(any(checkpoint is not None for _, _, checkpoint, *_ in records))
        with (
            reported(
                _unrecorded(records),
                f"; the episodes before it are. Solve that, and resume the run in {self.directory}",
                settings=("resume",),
            ),
            transaction(self._connection),
        ):
            for trial_id, result, checkpoint, answers, readings in records:
                key = self._keys[trial_id]
                self._connection.execute(_PUT_EPISODE, (key, *result))
                for answer in answers:
                    self._connection.execute(_PUT_ANSWER, (key, result.episode, *answer))
                for name, *numbers in readings:
                    self._connection.execute(_PUT_METRIC, (key, result.episode, name, *numbers))
                if checkpoint is not None:
                    self._thin(key)
                    row = (key, result.episode, checkpoint.agent, checkpoint.environment)
                    self._connection.execute(_PUT_CHECKPOINT, row)
        self._done.update(done)

    def _thin(self, key: int) -> None:
        """Replace values of metrics by their means, where a trial has passed them for good."""
        rows = self._connection.execute(
            """SELECT name, number, step, episode, value, every, averaged FROM metrics
                WHERE trial = ? AND averaged ORDER BY name, number""",
            (key,),
        ).fetchall()
        for name, group in itertools.groupby(rows, key=lambda row: row[0]):
            before = [row[1:] for row in group]
            means = thinned(before)
            last = means[-1][0] if means else 0
            if sum(row[0] <= last for row in before) == len(means):
                continue
            self._connection.execute(
                "DELETE FROM metrics WHERE trial = ? AND name = ? AND number <= ?", (key, name, last)
            )
            for number, step, episode, value, every, averaged in means:
                row = (key, episode, name, number, step, value, every, averaged)
                self._connection.execute(_PUT_METRIC, row)

    def extend(self, trials: Sequence[TrialSpec]) -> None:
        """Commit the trials of a longer plan: new ones are added, the others get its length."""
        with self._writing(), transaction(self._connection):
            for spec in trials:
                if spec.id in self._keys:
                    self._connection.execute(
                        "UPDATE trials SET episodes = ?, steps = ? WHERE key = ?",
                        (spec.episodes, spec.steps, self._keys[spec.id]),
                    )
                else:
                    self._connection.execute(_PUT_TRIAL, _trial_row(spec))
        self._keys.update(self._query("SELECT id, key FROM trials"))
        self._done = {trial_id: self._done.get(trial_id, 0) for trial_id in self._keys}

    def record_void(self, trial_id: str, episode: int, why: str) -> None:
        """Commit that an attempt at an episode does not count."""
        self._execute(_PUT_VOID, self._clock(), self._key(trial_id), episode, why)

    def record_event(self, kind: str, text: str, trial_id: str | None = None) -> None:
        """Commit an event; `kind` is one word, `text` a sentence for people."""
        key = None if trial_id is None else self._key(trial_id)
        self._execute(_PUT_EVENT, self._clock(), key, kind, text)

    def record_player(self, trial_id: str, role: str, name: str, program: str | None) -> Player:
        """Commit, also as an event, that a player joined a trial from outside; return its record."""
        player = Player(self._clock(), trial_id, role, name, program)
        self._execute(_PUT_PLAYER, player.time, self._key(trial_id), role, name, program)
        self.record_event("joined", f"{player} joined", trial_id)
        return player

    def record_failure(self, trial_id: str, why: str) -> None:
        """Commit that a trial has failed; its episodes are kept."""
        self._execute("UPDATE trials SET failure = ? WHERE key = ?", why, self._key(trial_id))

    def record_outcome(self, trial_id: str, outcome: Outcome) -> None:
        """Commit how a trial of a competition ended, and flush everything about it to the disk."""
        self._flush_commits(True)
        self._execute(_PUT_OUTCOME, self._key(trial_id), *outcome)

    def record_verdict(self, trial_id: str, verdict: Verdict) -> None:
        """Commit the result of replaying a trial, in place of an earlier one."""
        self._execute(_PUT_VERDICT, self._key(trial_id), *verdict)

    def rewind(self, trial_id: str, episode: int) -> None:
        """Delete the episodes of a trial after `episode` (0: all of them) and how it ended, to repeat them.

        Raises:
            ExperimentError: the database cannot be written to.
        """
        key = self._key(trial_id)
        with self._writing(), transaction(self._connection):
            for table in ("episodes", "answers", "metrics", "checkpoints"):
                self._connection.execute(
                    f"DELETE FROM {table} WHERE trial = ? AND episode > ?", (key, episode)
                )
            self._connection.execute("UPDATE trials SET failure = NULL WHERE key = ?", (key,))
            for table in ("outcomes", "verdicts"):
                self._connection.execute(f"DELETE FROM {table} WHERE trial = ?", (key,))
        self._done[trial_id] = min(self._done[trial_id], episode)

    def adopt(self, results: Results, trial_id: str, as_id: str) -> None:
        """Copy all records of a trial of another run to a trial of this run, in place of its own.

        Raises:
            ExperimentError: they cannot be read or written; then nothing is copied.
        """
        key = self._key(as_id)
        failures = [record.failure for record in results.trials() if record.spec.id == trial_id]
        # Read before the episodes: in a run under way, it must not include one that is not copied.
        checkpoint = results.checkpoint(trial_id)
        episodes = results.episodes(trial_id)
        answers = [answered for answered in results.answers(trial_id) if answered.episode <= len(episodes)]
        metrics = [row for row in results.metric_rows(trial_id) if row[0] <= len(episodes)]
        voids = [void for void in results.voids() if void.trial_id == trial_id]
        events = [event for event in results.events() if event.trial_id == trial_id]
        players = [player for player in results.players() if player.trial_id == trial_id]
        outcome, verdict = results.outcomes().get(trial_id), results.verdicts().get(trial_id)
        write = self._connection.executemany
        with self._writing(), transaction(self._connection):
            for table in _TABLES:
                self._connection.execute(f"DELETE FROM {table} WHERE trial = ?", (key,))
            write("UPDATE trials SET failure = ? WHERE key = ?", ((why, key) for why in failures))
            write(_PUT_EPISODE, ((key, *e) for e in episodes))
            write(_PUT_ANSWER, ((key, a.episode, a.message, a.answer) for a in answers))
            write(_PUT_METRIC, ((key, *row) for row in metrics))
            if checkpoint is not None:
                episode, saved = checkpoint
                write(_PUT_CHECKPOINT, [(key, episode, saved.agent, saved.environment)])
            write(_PUT_VOID, ((v.time, key, v.episode, v.why) for v in voids))
            write(_PUT_EVENT, ((e.time, key, e.kind, e.text) for e in events))
            write(_PUT_PLAYER, ((p.time, key, p.role, p.name, p.program) for p in players))
            write(_PUT_OUTCOME, [(key, *outcome)] if outcome else [])
            write(_PUT_VERDICT, [(key, *verdict)] if verdict else [])
        self._done[as_id] = len(episodes)

    def done(self, trial_id: str) -> int:
        """Return the number of recorded episodes of a trial."""
        self._key(trial_id)
        return self._done[trial_id]

    def _key(self, trial_id: str) -> int:
        if trial_id not in self._keys:
            raise ExperimentError(f"{self.directory} has no trial {trial_id}")
        return self._keys[trial_id]

    def _flush_commits(self, wanted: bool) -> None:
        """Let commits be flushed to the disk, or not."""
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
    return (spec.id, *roles, spec.episodes, spec.max_steps, spec.seed, spec.steps)


def _role_text(role: RoleSpec | None) -> str | None:
    if role is None:
        return None
    return json.dumps({"name": role.name, "options": dict(role.options), "label": role.label})
