"""The files of a run directory: how they come to be there, whole or not at all, and how they are removed.

A run is made in a folder of its own within the directory, and its files are moved out at the end, the
database last: from then on, and not before, the directory holds a run. Nothing that was there is ever
replaced or removed, and what a killed process leaves in that folder does not count.
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
from glue.errors import ExperimentError

__all__ = ["ABOUT_FILE", "PLAN_FILE", "UNFINISHED", "NewRun", "new_run", "remove_run", "write_flushed"]

PLAN_FILE: Final = "plan.toml"
ABOUT_FILE: Final = "run.json"
UNFINISHED: Final = ".unfinished"  # the folder that a run is made in


class NewRun(NamedTuple):
    """A run directory that is being made: the folder to put its files in, and its lock."""

    folder: Path
    lock: RunLock


@contextlib.contextmanager
def new_run(directory: Path) -> Iterator[NewRun]:
    """Make a run directory; at the end it holds the files put in `NewRun.folder`, and the lock is held.

    On an exception nothing is left of what was made, and the lock is released.

    Args:
        directory: is made, with its parents; if it exists, it is empty.

    Raises:
        ExperimentError: the directory holds a run or anything else, or another process makes one in it.
        OSError: it cannot be written to.
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
        shutil.rmtree(folder, ignore_errors=True)  # of a process that was killed
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
            with contextlib.suppress(OSError):  # another process puts something in
                directory.rmdir()
        raise


def remove_run(directory: Path) -> list[str]:
    """Remove a run, and its directory unless it holds anything else; return the names of what stays.

    Raises:
        ExperimentError: there is no run, or another process writes to it.
        OSError: a file cannot be removed.
    """
    if not holds_run(directory):
        raise ExperimentError(f"{directory} holds no run")
    lock = RunLock(directory)
    try:
        # The database first: once it is gone, what a kill may leave does not count as a run.
        for name in (*DATABASE_FILES, PLAN_FILE, ABOUT_FILE, LOCK_FILE):
            (directory / name).unlink(missing_ok=True)
        shutil.rmtree(directory / UNFINISHED, ignore_errors=True)
    finally:
        lock.release()
    left = sorted(path.name for path in directory.iterdir())
    if not left:
        directory.rmdir()
    return left


def write_flushed(path: Path, text: str) -> None:
    """Write a text file so that it survives a loss of power."""
    with path.open("w", encoding="utf-8") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())


def _check_free(directory: Path) -> None:
    if holds_run(directory):
        raise ExperimentError(
            f"{directory} holds a run: continue it with --resume {directory}, "
            "or choose another directory with --out"
        )
    for path in directory.iterdir():
        if path.name not in (LOCK_FILE, UNFINISHED):
            raise _taken(directory, path.name)


def _taken(directory: Path, name: str) -> ExperimentError:
    return ExperimentError(
        f"{directory} is not empty: it holds {name}. A run needs a directory of its own: "
        "choose another with --out"
    )


def _publish(folder: Path, directory: Path) -> None:
    """Move the files of a run out of its folder, the database last; on an exception none is moved."""
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
