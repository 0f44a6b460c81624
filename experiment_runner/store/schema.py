"""The tables of a run's database, and the migrations from older versions."""

from __future__ import annotations

import contextlib
import itertools
import sqlite3
from functools import lru_cache
from pathlib import Path
from typing import Final

from experiment_runner.store.records import MEASURES
from glue.errors import ExperimentError

_APPLICATION_ID: Final = int.from_bytes(b"GLUE", "big")


def _columns(*measures: str) -> str:
    return ",\n            ".join(MEASURES[name].sql for name in measures)


# Entry n migrates version n to version n + 1. Never change a released entry: add another.
MIGRATIONS: tuple[tuple[str, ...], ...] = (
    (
        f"PRAGMA application_id = {_APPLICATION_ID}",
        # agent and environment: JSON of name, options and label; NULL when it connects from outside.
        """CREATE TABLE trials (
            key INTEGER PRIMARY KEY,
            id TEXT NOT NULL UNIQUE,
            agent TEXT,
            environment TEXT,
            episodes INTEGER NOT NULL,
            max_steps INTEGER NOT NULL,
            seed INTEGER NOT NULL,
            failure TEXT)""",
        # episode counts from 1; SQLite has no NaN, so such a return is NULL.
        f"""CREATE TABLE episodes (
            trial INTEGER NOT NULL REFERENCES trials,
            episode INTEGER NOT NULL CHECK (episode >= 1),
            {_columns("return", "steps", "terminal", "wall_time")},
            PRIMARY KEY (trial, episode)) WITHOUT ROWID""",
        # The newest checkpoint of each trial: the state of agent and environment after `episode`.
        """CREATE TABLE checkpoints (
            trial INTEGER PRIMARY KEY REFERENCES trials,
            episode INTEGER NOT NULL,
            agent BLOB NOT NULL,
            environment BLOB NOT NULL)""",
        # time: seconds since 1970, UTC.
        """CREATE TABLE voids (
            time REAL NOT NULL,
            trial INTEGER NOT NULL REFERENCES trials,
            episode INTEGER NOT NULL,
            why TEXT NOT NULL)""",
        """CREATE TABLE events (
            time REAL NOT NULL,
            trial INTEGER REFERENCES trials,
            kind TEXT NOT NULL,
            text TEXT NOT NULL)""",
    ),
    (
        # How a trial of a competition ended. reason: why its entrant forfeited it, NULL if it played to the
        # end; digest: SHA-256 of the trial's record.
        """CREATE TABLE outcomes (
            trial INTEGER PRIMARY KEY REFERENCES trials,
            reason TEXT,
            digest BLOB NOT NULL)""",
        # The result of replaying a record. digest: as above, of the record that was replayed;
        # problem: what did not match, NULL if everything did; SQLite has no NaN, so such a score is NULL.
        """CREATE TABLE verdicts (
            trial INTEGER PRIMARY KEY REFERENCES trials,
            digest BLOB NOT NULL,
            problem TEXT,
            score REAL)""",
    ),
    (
        # Answers of the agent to messages after `episode`.
        """CREATE TABLE answers (
            trial INTEGER NOT NULL REFERENCES trials,
            episode INTEGER NOT NULL,
            message TEXT NOT NULL,
            answer TEXT NOT NULL,
            PRIMARY KEY (trial, episode, message)) WITHOUT ROWID""",
    ),
    (
        # Players that joined from outside. program: language or library, NULL if unknown.
        """CREATE TABLE players (
            time REAL NOT NULL,
            trial INTEGER NOT NULL REFERENCES trials,
            role TEXT NOT NULL,
            name TEXT NOT NULL,
            program TEXT)""",
        # Until then an event was the only record: `agent Jumper (Python 3.11) joined`. The last `(` is found
        # by trimming all other characters from the right.
        """INSERT INTO players
            SELECT time, trial, role, iif(opens > 1, substr(label, 1, opens - 2), label),
                iif(opens > 1, substr(label, opens + 1, length(label) - opens - 1), NULL)
            FROM (SELECT *, iif(label LIKE '% (%)', length(rtrim(label, replace(label, '(', ''))), 0) AS opens
                FROM (SELECT rowid AS number, time, trial, substr(text, 1, instr(text, ' ') - 1) AS role,
                    substr(text, instr(text, ' ') + 1, length(text) - instr(text, ' ') - 7) AS label
                    FROM events WHERE kind = 'joined' AND trial IS NOT NULL
                    AND (text LIKE 'agent % joined' OR text LIKE 'environment % joined')))
            ORDER BY number""",
    ),
    (
        # The budget of a trial in steps; 0 if it has a number of episodes, which is 0 otherwise.
        "ALTER TABLE trials ADD COLUMN steps INTEGER NOT NULL DEFAULT 0",
    ),
    (),  # of no release
    (
        # Names of metrics that were read at the same time, one on each line.
        "CREATE TABLE metric_names (key INTEGER PRIMARY KEY, names TEXT NOT NULL UNIQUE)",
        # Readings until `episode`; see `experiment_runner.store.readings`.
        """CREATE TABLE readings (
            trial INTEGER NOT NULL REFERENCES trials,
            episode INTEGER NOT NULL,
            names INTEGER NOT NULL REFERENCES metric_names,
            data BLOB NOT NULL,
            PRIMARY KEY (trial, episode, names)) WITHOUT ROWID""",
        # The values of metrics that are not averaged yet.
        "ALTER TABLE checkpoints ADD COLUMN metrics BLOB NOT NULL DEFAULT x''",
    ),
    (
        # The pace of the environment; see glue.pace.
        "ALTER TABLE trials ADD COLUMN rate REAL NOT NULL DEFAULT 0",
        "ALTER TABLE trials ADD COLUMN late TEXT NOT NULL DEFAULT 'repeat'",
        "ALTER TABLE trials ADD COLUMN delay INTEGER NOT NULL DEFAULT 0",
        # Number of the agent's late actions; NULL where it is not known.
        f"ALTER TABLE episodes ADD COLUMN {_columns('late')}",
    ),
)


def check(connection: sqlite3.Connection, directory: Path) -> int:
    """Return the version of the database of `directory`; 0 if it is empty.

    A run directory may come from anyone, and a view in place of a table could execute any query when it
    is read. So the database may contain only the tables of its version.

    Raises:
        ExperimentError: the database is not that of a run, was written by a newer release, or contains
            anything else.
        sqlite3.Error: the database cannot be read.
    """
    version = int(connection.execute("PRAGMA user_version").fetchone()[0])
    application = int(connection.execute("PRAGMA application_id").fetchone()[0])
    found = _objects(connection)
    database = f"cannot read {directory}: results.sqlite"
    if application != _APPLICATION_ID and (application or version or found):
        raise ExperimentError(f"{database} was not written by glue-experiment")
    if version > len(MIGRATIONS):
        raise ExperimentError(
            f"{database} has version {version}, and this program reads versions up to {len(MIGRATIONS)}: "
            "a newer release wrote it; install that release"
        )
    for kind, name, _ in sorted(found ^ _expected(MIGRATIONS[: max(version, 0)])):
        raise ExperimentError(f"{database} was changed by another program, as its {kind} {name!r} shows")
    return version


def migrate(connection: sqlite3.Connection, directory: Path) -> None:
    """Migrate a database, empty or old, to the newest version. Call it within a transaction.

    Raises:
        ExperimentError: see `check`.
        sqlite3.Error: the database cannot be written to.
    """
    _apply(connection, MIGRATIONS[check(connection, directory) :])
    connection.execute(f"PRAGMA user_version = {len(MIGRATIONS)}")


def _apply(connection: sqlite3.Connection, migrations: tuple[tuple[str, ...], ...]) -> None:
    for statement in itertools.chain.from_iterable(migrations):
        connection.execute(statement)


@lru_cache
def _expected(migrations: tuple[tuple[str, ...], ...]) -> frozenset[tuple[str, str, str]]:
    with contextlib.closing(sqlite3.connect(":memory:", isolation_level=None)) as connection:
        _apply(connection, migrations)
        return _objects(connection)


def _objects(connection: sqlite3.Connection) -> frozenset[tuple[str, str, str]]:
    """Return the kind, name and definition of everything in a database's schema."""
    rows = connection.execute("SELECT type, name, sql FROM sqlite_master LIMIT 1000").fetchall()
    return frozenset((str(kind), str(name), " ".join(str(sql).split())) for kind, name, sql in rows)
