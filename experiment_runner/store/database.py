"""A run's SQLite database: its tables, how older ones become today's, how it is opened.

WAL mode with `synchronous` NORMAL: readers never wait and never delay the writer, and a commit
outlives every process, whatever kills it. What was committed since the last flush may be missing
after the machine itself lost power, always from the end, and never damages the rest.
"""

from __future__ import annotations

import contextlib
import errno
import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from glue.errors import ExperimentError

__all__ = [
    "DATABASE_FILES",
    "MIGRATIONS",
    "StorageError",
    "connect_to_read",
    "connect_to_write",
    "holds_run",
    "migrate",
    "reported",
    "schema_version",
    "transaction",
]

_DATABASE: Final = "results.sqlite"
_WAL: Final = _DATABASE + "-wal"
DATABASE_FILES: Final = (_DATABASE, _WAL, _DATABASE + "-shm")

_APPLICATION_ID: Final = int.from_bytes(b"GLUE", "big")
_BUSY_SECONDS: Final = 10.0

# Entry n makes version n + 1 out of version n. Never change one that was released: add another.
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
        # episode counts from 1; SQLite has no NaN, so a return that is not a number is NULL;
        # terminal is 0 when the episode was cut off; wall_time is in seconds.
        """CREATE TABLE episodes (
            trial INTEGER NOT NULL REFERENCES trials,
            episode INTEGER NOT NULL CHECK (episode >= 1),
            episode_return REAL,
            steps INTEGER NOT NULL,
            terminal INTEGER NOT NULL CHECK (terminal IN (0, 1)),
            wall_time REAL NOT NULL,
            PRIMARY KEY (trial, episode)) WITHOUT ROWID""",
        # The newest checkpoint of each trial: what agent and environment were after `episode`.
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
)


class StorageError(ExperimentError):
    """The disk or the database failed: nothing more can be stored. What was committed is safe."""


def holds_run(directory: Path) -> bool:
    """Return whether a directory holds a run; one whose making was interrupted does not count.

    Raises:
        ExperimentError: its database is somebody else's, or too new.
        sqlite3.Error: its database cannot be read.
    """
    if not (directory / _DATABASE).is_file():
        return False
    with contextlib.closing(_open_to_read(directory)) as connection:
        return schema_version(connection) > 0


def connect_to_read(directory: Path) -> sqlite3.Connection:
    """Return a connection that cannot write, with today's tables.

    Raises:
        ExperimentError: there is no run, or its database is somebody else's, or too new.
        sqlite3.Error: it cannot be read.
    """
    if not holds_run(directory):
        raise ExperimentError(f"{directory} holds no run")
    connection = _open_to_read(directory)
    if schema_version(connection) == len(MIGRATIONS):
        return connection
    with contextlib.closing(connection):
        copy = sqlite3.connect(":memory:", isolation_level=None)
        connection.backup(copy)
    with transaction(copy):
        migrate(copy)
    return copy


def connect_to_write(directory: Path) -> sqlite3.Connection:
    """Return a connection that can write; whether there are tables yet is for the caller to see.

    Raises:
        sqlite3.Error: it cannot be written to.
    """
    connection = sqlite3.connect(directory / _DATABASE, isolation_level=None, timeout=_BUSY_SECONDS)
    try:
        for pragma in ("journal_mode = WAL", "synchronous = NORMAL", "foreign_keys = ON"):
            connection.execute(f"PRAGMA {pragma}")
    except BaseException:
        connection.close()
        raise
    return connection


def schema_version(connection: sqlite3.Connection) -> int:
    """Return the version of a database; 0 for one that is empty.

    Raises:
        ExperimentError: it is not a run's, or was written by a newer release.
        sqlite3.Error: it cannot be read.
    """
    version = int(connection.execute("PRAGMA user_version").fetchone()[0])
    application = int(connection.execute("PRAGMA application_id").fetchone()[0])
    tables = int(connection.execute("SELECT count(*) FROM sqlite_master").fetchone()[0])
    if application != _APPLICATION_ID and (application or version or tables):
        raise ExperimentError(f"{_DATABASE} was not written by glue-experiment")
    if version > len(MIGRATIONS):
        raise ExperimentError(
            f"{_DATABASE} has version {version} and this program knows versions up to {len(MIGRATIONS)}: "
            "a newer release wrote it; install that one"
        )
    return version


def migrate(connection: sqlite3.Connection) -> None:
    """Bring a database, empty or old, to the newest version. To be called within a transaction.

    Raises:
        ExperimentError: as `schema_version`.
        sqlite3.Error: it cannot be written.
    """
    for statements in MIGRATIONS[schema_version(connection) :]:
        for statement in statements:
            connection.execute(statement)
    connection.execute(f"PRAGMA user_version = {len(MIGRATIONS)}")


@contextlib.contextmanager
def transaction(connection: sqlite3.Connection) -> Iterator[None]:
    """Commit what is done within, or on an exception nothing of it."""
    connection.execute("BEGIN IMMEDIATE")
    try:
        yield
        connection.execute("COMMIT")
    except BaseException:
        if connection.in_transaction:  # SQLite itself rolls back after some errors
            connection.execute("ROLLBACK")
        raise


@contextlib.contextmanager
def reported(failed: str, hint: str = "") -> Iterator[None]:
    """Turn an error of the disk or the database into one for people: `failed`, the reason, `hint`."""
    try:
        yield
    except BrokenPipeError:  # whoever read our output has seen enough, which is no error
        raise
    except (OSError, sqlite3.Error) as error:
        raise StorageError(f"{failed}: {_reason(error)}{hint}") from error


def _reason(error: OSError | sqlite3.Error) -> str:
    if isinstance(error, OSError):
        return "the disk is full" if error.errno == errno.ENOSPC else error.strerror or str(error)
    code = getattr(error, "sqlite_errorcode", None)
    return "the disk is full" if code == sqlite3.SQLITE_FULL else str(error)


def _open_to_read(directory: Path) -> sqlite3.Connection:
    uri = (directory / _DATABASE).absolute().as_uri() + "?mode=ro"
    connection = sqlite3.connect(uri, uri=True, isolation_level=None, timeout=_BUSY_SECONDS)
    try:
        connection.execute("PRAGMA user_version")
    except sqlite3.OperationalError:
        connection.close()
        if (directory / _WAL).exists():
            raise
        # Reading in WAL mode makes two files. Where none can be made nobody writes either, and
        # without a WAL the database is whole by itself.
        connection = sqlite3.connect(uri + "&immutable=1", uri=True, isolation_level=None)
    return connection
