"""One writer for each run directory: a lock that the operating system drops when its holder dies.

The lock is a `flock`, so a process that is forked (not spawned) while it is held shares and keeps it.
"""

from __future__ import annotations

import fcntl
import os
import platform
import re
import time
from pathlib import Path
from typing import Final

from glue.errors import ExperimentError

LOCK_FILE: Final = "lock"

# `lock_holder` acquires the lock for an instant to see whether it is free.
_ATTEMPTS: Final = 5
_PAUSE: Final = 0.05
_LONGEST: Final = 200  # bytes of the file that are read


class DirectoryTaken(ExperimentError):
    """A directory is in use, or holds something other than the wanted run.

    Attributes:
        directory: the directory.
    """

    def __init__(self, directory: Path, why: str) -> None:
        super().__init__(f"{directory} {why}")
        self.directory = directory


class RunLock:
    """Holds the lock of a run directory until `release`, or until the process ends.

    Raises:
        DirectoryTaken: another process holds it; the message names that process.
        OSError: the lock file cannot be written.
    """

    def __init__(self, directory: Path) -> None:
        path = directory / LOCK_FILE
        self._file = os.open(path, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            # A file that its last holder removed meanwhile locks nothing.
            if not _try_lock(self._file, _ATTEMPTS) or not _is_open_as(self._file, path):
                raise DirectoryTaken(directory, f"is in use by {_name_in(self._file)}")
            os.truncate(self._file, 0)
            os.pwrite(self._file, f"process {os.getpid()} on {platform.node()}".encode(), 0)
        except BaseException:
            self.release()
            raise

    def release(self) -> None:
        """Let another process write. May be called twice."""
        if self._file >= 0:
            os.close(self._file)
        self._file = -1


def lock_holder(directory: Path) -> str | None:
    """Return the process that writes to a run directory, as in `process 42 on lab7`; None if none does."""
    try:
        file = os.open(directory / LOCK_FILE, os.O_RDONLY)
    except OSError:
        return None
    try:
        return None if _try_lock(file, 1, fcntl.LOCK_SH) else _name_in(file)
    finally:
        os.close(file)


def is_lock(path: Path) -> bool:
    """Return True for a file that `RunLock` wrote, and for an empty one, as left by a full disk."""
    with path.open("rb") as file:
        return re.fullmatch(rb"(process \d+ on .*)?", file.read(_LONGEST)) is not None


def _is_open_as(file: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(file), path.stat())
    except FileNotFoundError:
        return False


def _try_lock(file: int, attempts: int, kind: int = fcntl.LOCK_EX) -> bool:
    for attempt in range(attempts):
        if attempt:
            time.sleep(_PAUSE)
        try:
            fcntl.flock(file, kind | fcntl.LOCK_NB)
        except BlockingIOError:
            continue
        return True
    return False


def _name_in(file: int) -> str:
    return os.pread(file, _LONGEST, 0).decode(errors="replace") or "another process"
