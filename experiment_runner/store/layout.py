"""The files of a run directory: they are created all or none, and removed.

A new run is written to a subfolder of the directory, and its files are then moved up, the database last.
Only then does the directory hold a run; a subfolder that a killed process leaves behind is ignored. Files
that were there before are never replaced or removed.
"""

from __future__ import annotations

import contextlib
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Final, NamedTuple

from experiment_runner.lock import LOCK_FILE, RunLock, is_lock
from experiment_runner.store.database import DATABASE_FILES, holds_run
from experiment_runner.store.meetings import MEETINGS_FILE
from glue.errors import ExperimentError

__all__ = [
    "ABOUT_FILE",
    "COMPETITION_FILE",
    "LOGS",
    "PLAN_FILE",
    "RECORDS",
    "UNFINISHED",
    "NewRun",
    "how_to_go_on",
    "new_run",
    "remove_run",
    "runs_under",
    "write_flushed",
]

PLAN_FILE: Final = "plan.toml"
ABOUT_FILE: Final = "run.json"
COMPETITION_FILE: Final = "competition.toml"
RECORDS: Final = "records"  # a folder of a competition's run: what was played
LOGS: Final = "logs"  # another: what the entrants printed

UNFINISHED: Final = ".unfinished"  # the subfolder in which a new run is written


class NewRun(NamedTuple):
    """A run directory under construction: the folder for its files, and its lock."""

    folder: Path
    lock: RunLock


@contextlib.contextmanager
def new_run(directory: Path) -> Iterator[NewRun]:
    """Create a run directory from the files that are put in `NewRun.folder`; the lock stays held.

    On an exception everything that was created is removed, and the lock is released.

    Args:
        directory: created with its parents; if it exists, it must be empty.

    Raises:
        ExperimentError: the directory is not empty, or another process is creating a run in it.
        OSError: the directory cannot be written to.
    """
    made = not directory.exists()
    directory.mkdir(parents=True, exist_ok=True)
    had_lock = (directory / LOCK_FILE).exists()
    lock = None
    try:
        if not had_lock:
            _check_free(directory)
        elif not is_lock(directory / LOCK_FILE):
            raise _taken(directory, LOCK_FILE)
        lock = RunLock(directory)
        _check_free(directory)
        folder = directory / UNFINISHED
        shutil.rmtree(folder, ignore_errors=True)  # left by a process that was killed
        folder.mkdir()
        yield NewRun(folder, lock)
        _publish(folder, directory)
    except BaseException:
        if lock is not None:
            shutil.rmtree(directory / UNFINISHED, ignore_errors=True)
            if not had_lock:
                (directory / LOCK_FILE).unlink(missing_ok=True)
            lock.release()
        if made:
            with contextlib.suppress(OSError):  # another process has put something in it
                directory.rmdir()
        raise


def remove_run(directory: Path) -> list[str]:
    """Remove a run, and its directory unless it holds anything else.

    Returns:
        The names of the other files, which stay.

    Raises:
        ExperimentError: there is no run, or another process writes to it.
        OSError: a file cannot be removed.
    """
    if not holds_run(directory):
        raise ExperimentError(f"{directory} holds no run")
    lock = RunLock(directory)
    try:
        # The database first: without it, what is left if this process is killed does not count as a run.
        competes = (directory / COMPETITION_FILE).is_file()
        for name in (*DATABASE_FILES, PLAN_FILE, COMPETITION_FILE, ABOUT_FILE, MEETINGS_FILE, LOCK_FILE):
            (directory / name).unlink(missing_ok=True)
        for name in (UNFINISHED, *((RECORDS, LOGS) if competes else ())):
            shutil.rmtree(directory / name, ignore_errors=True)
    finally:
        lock.release()
    left = sorted(path.name for path in directory.iterdir())
    if not left:
        directory.rmdir()
    return left


def runs_under(folder: Path) -> Iterator[Path]:
    """Yield what looks like a run in a folder, or the folder itself, in the order of the names."""
    for path, folders, files in os.walk(folder):
        folders[:] = sorted(name for name in folders if name != UNFINISHED)
        if DATABASE_FILES[0] in files:
            folders.clear()
            yield Path(path)


def how_to_go_on(directory: Path) -> str:
    """Return what somebody is to do whose run has ended early, once the reason is gone."""
    if (directory / COMPETITION_FILE).exists():
        return "start the same command again"
    return f"continue with --resume {directory}"


def write_flushed(path: Path, text: str) -> None:
    """Write a text file and flush it to the disk."""
    with path.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())


def _check_free(directory: Path) -> None:
    if holds_run(directory):
        # One that was merged from others cannot be continued, and a competition in its own way.
        hint = f"continue it with --resume {directory}, or " if (directory / PLAN_FILE).exists() else ""
        raise ExperimentError(f"{directory} holds a run: {hint}choose another directory with --out")
    for path in directory.iterdir():
        if path.name not in (LOCK_FILE, UNFINISHED):
            raise _taken(directory, path.name)


def _taken(directory: Path, name: str) -> ExperimentError:
    return ExperimentError(
        f"{directory} is not empty: it holds {name}. A run needs a directory of its own: "
        "choose another with --out"
    )


def _publish(folder: Path, directory: Path) -> None:
    """Move the files of a new run up into its directory, the database last; on an exception, none."""
    _check_free(directory)
    names = sorted((path.name for path in folder.iterdir()), key=lambda name: name in DATABASE_FILES)
    moved = []
    try:
        for name in names:
            (folder / name).rename(directory / name)
            moved.append(directory / name)
        folder.rmdir()
        _flush_names(directory)
    except BaseException:
        for path in moved:
            path.unlink(missing_ok=True)
        raise


def _flush_names(directory: Path) -> None:
    handle = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
