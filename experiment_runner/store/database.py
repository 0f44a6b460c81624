"""A run's SQLite database: how it is opened, read and written.

WAL mode with `synchronous` NORMAL: readers never wait and never delay the writer, and a commit
survives the process, however it ends. If the machine loses power, the commits since the last flush may
be lost; all earlier commits are intact.

A database is not trusted, since a run may come from anyone. Its tables are checked before they are used
(see `schema`), and the work and the texts of a query are limited in proportion to the size of the files.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import sqlite3
import stat
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Final

from experiment_runner.store import schema
from glue.errors import ExperimentError

_DATABASE: Final = "results.sqlite"
_WAL: Final = _DATABASE + "-wal"
_SHM: Final = _DATABASE + "-shm"
DATABASE_FILES: Final = (_DATABASE, _WAL, _SHM)

_BUSY_SECONDS: Final = 10.0

# SQLite's virtual machine executes some 20 instructions a row, a row takes at least 10 bytes, and most
# queries read each row once: a query of an intact run never gets near this limit.
_INSTRUCTIONS_PER_BYTE: Final = 100
_INSTRUCTIONS_AT_LEAST: Final = 10_000_000  # a fraction of a second
_INSTRUCTIONS_A_TICK: Final = 100_000

# A query may return the id of a trial, or the names of its metrics, once for each row that refers to it.
_LETTERS_PER_BYTE: Final = 100
_LETTERS_AT_LEAST: Final = 2**26


class StorageError(ExperimentError):
    """The disk or the database failed: nothing more can be stored. Earlier commits are safe."""


class Database:
    """A connection whose queries always end: when done, at a limit on their work, or on Ctrl-C."""

    def __init__(self, connection: sqlite3.Connection, directory: Path) -> None:
        self.connection = connection
        self._directory = directory
        self._work = 0  # of the current query, in instructions
        self._stopped = False
        self._letters = 0  # of the texts of the current query, in bytes
        connection.set_progress_handler(self._tick, _INSTRUCTIONS_A_TICK)
        connection.text_factory = self._text

    def query(self, statement: str, *values: object) -> list[Any]:
        """Return the rows of a SELECT.

        Raises:
            sqlite3.Error: the database cannot be read.
            ExperimentError: the query exceeds the work, or its texts the size, that a database of this size
                may need.
        """
        self._work = self._letters = 0
        self._stopped = False
        try:
            return self.connection.execute(statement, values).fetchall()
        except sqlite3.OperationalError as error:
            if getattr(error, "sqlite_errorcode", None) != sqlite3.SQLITE_INTERRUPT:
                raise
            if not self._stopped:  # Ctrl-C was raised in `_tick`, where SQLite swallows exceptions
                raise KeyboardInterrupt from None
            raise self._damaged("a query does not end") from None

    def close(self) -> None:
        """Close the files. May be called twice."""
        self.connection.close()

    def _tick(self) -> bool:
        self._work += _INSTRUCTIONS_A_TICK
        if self._work > _INSTRUCTIONS_AT_LEAST:
            self._stopped = self._work > _INSTRUCTIONS_PER_BYTE * _size(self._directory)
        return self._stopped

    def _text(self, data: bytes) -> str:
        self._letters += len(data)
        if self._letters > _LETTERS_AT_LEAST and self._letters > _LETTERS_PER_BYTE * _size(self._directory):
            raise self._damaged("its texts are repeated too often")
        return data.decode()

    def _damaged(self, what: str) -> ExperimentError:
        return ExperimentError(f"cannot read {self._directory}: {_DATABASE} is damaged: {what}")


def holds_run(directory: Path) -> bool:
    """Return whether a directory holds a run's database.

    Raises:
        ExperimentError: the database is not that of a run, or a newer release wrote it.
        sqlite3.Error: the database cannot be read.
    """
    if not os.path.lexists(directory / _DATABASE):
        return False
    with contextlib.closing(_connect_to_read(directory)) as connection:
        return schema.check(connection, directory) > 0


def open_to_read(directory: Path) -> Database:
    """Return a read-only database with the current tables; an older one is migrated in memory.

    Raises:
        ExperimentError: there is no run, the database is not that of a run, or a newer release wrote it.
        sqlite3.Error: the database cannot be read.
    """
    if not holds_run(directory):
        raise ExperimentError(f"{directory} holds no run")
    connection = _connect_to_read(directory)
    try:
        if schema.check(connection, directory) < len(schema.MIGRATIONS):
            old, connection = connection, sqlite3.connect(":memory:", isolation_level=None)
            with contextlib.closing(old):
                old.backup(connection)
            with transaction(connection):
                schema.migrate(connection, directory)
    except BaseException:
        connection.close()
        raise
    return Database(connection, directory)


def open_to_write(directory: Path) -> Database:
    """Return a writable database with the current tables; it is created, or migrated, if necessary.

    Raises:
        ExperimentError: the database is not that of a run, or a newer release wrote it.
        sqlite3.Error: the database cannot be written to.
    """
    _check_files(directory, links=1)
    connection = sqlite3.connect(directory / _DATABASE, isolation_level=None, timeout=_BUSY_SECONDS)
    try:
        for pragma in ("journal_mode = WAL", "synchronous = NORMAL", "foreign_keys = ON"):
            connection.execute(f"PRAGMA {pragma}")
        with transaction(connection):
            schema.migrate(connection, directory)
    except BaseException:
        connection.close()
        raise
    return Database(connection, directory)


@contextlib.contextmanager
def transaction(connection: sqlite3.Connection) -> Iterator[None]:
    """Commit on exit, or roll back on an exception."""
    connection.execute("BEGIN IMMEDIATE")
    try:
        yield
        connection.execute("COMMIT")
    except BaseException:
        if connection.in_transaction:  # SQLite itself rolls back after some errors
            connection.execute("ROLLBACK")
        raise


KEPT: Final = "; solve that, and start the same command again: what was recorded is kept"
"""Hint for an error in writing to a run."""


@contextlib.contextmanager
def reported(failed: str, hint: str = "", *, settings: tuple[str, ...] = ()) -> Iterator[None]:
    """Turn an error of the disk or the database into a `StorageError`: `failed`, the reason, `hint`."""
    try:
        yield
    except BrokenPipeError:  # the program that reads our output has closed it: not an error
        raise
    except (OSError, sqlite3.Error, UnicodeError) as error:
        raise StorageError(f"{failed}: {_reason(error)}{hint}", settings=settings) from error


def _reason(error: OSError | sqlite3.Error | UnicodeError) -> str:
    if isinstance(error, UnicodeEncodeError):
        return "it would contain a name that is not UTF-8: rename that file or folder"
    if isinstance(error, UnicodeError):
        return "it contains text that is not UTF-8"
    if isinstance(error, OSError):
        return "the disk is full" if error.errno == errno.ENOSPC else error.strerror or str(error)
    code = getattr(error, "sqlite_errorcode", None)
    if code == sqlite3.SQLITE_BUSY:
        return f"{error}, or its file system has no locks: then use a copy of the run on another"
    return "the disk is full" if code == sqlite3.SQLITE_FULL else str(error)


def _size(directory: Path) -> int:
    return sum(path.stat().st_size for path in (directory / _DATABASE, directory / _WAL) if path.exists())


def _check_files(directory: Path, links: int | None = None) -> None:
    """Check that SQLite, which opens files by itself, opens those of this run and no others.

    Args:
        directory: of the run.
        links: maximum number of names of a file, None for any: a hard link may be another run's file, too.
    """
    for path in (directory / name for name in DATABASE_FILES):
        try:
            status = path.lstat()
        except FileNotFoundError:
            continue
        if not stat.S_ISREG(status.st_mode):
            kind = "a symbolic link" if path.is_symlink() else "no regular file"
            raise ExperimentError(f"{path} is {kind}, and may lead to another run: put the file itself there")
        if links is not None and status.st_nlink > links:
            raise ExperimentError(
                f"{path} is a hard link, and may be the file of another run, too: use a copy of the directory"
            )


def _connect_to_read(directory: Path) -> sqlite3.Connection:
    _check_files(directory)
    uri = (directory / _DATABASE).absolute().as_uri() + "?mode=ro"
    connection = sqlite3.connect(uri, uri=True, isolation_level=None, timeout=_BUSY_SECONDS)
    try:
        connection.execute("PRAGMA user_version")
    except sqlite3.OperationalError:
        connection.close()
        # Reading in WAL mode creates the -shm file. Where that is impossible, there is no writer either.
        if (directory / _SHM).exists():
            raise
        if (directory / _WAL).exists():
            return _connect_to_copy(directory)
        # Without a WAL, everything is in the database file.
        connection = sqlite3.connect(uri + "&immutable=1", uri=True, isolation_level=None)
    except BaseException:
        connection.close()
        raise
    return connection


def _connect_to_copy(directory: Path) -> sqlite3.Connection:
    """Return a connection to a copy, with the WAL applied: for a killed run on a read-only medium."""
    with tempfile.TemporaryDirectory() as folder:
        for name in (_DATABASE, _WAL):
            shutil.copyfile(directory / name, Path(folder, name))
        connection = sqlite3.connect(Path(folder, _DATABASE), isolation_level=None)
        try:
            # Moves what the WAL holds into the database file.
            connection.execute("PRAGMA journal_mode = DELETE")
        except BaseException:
            connection.close()
            raise
        return connection  # the open file remains readable after its name is gone
