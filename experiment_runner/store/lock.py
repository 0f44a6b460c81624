"""One writer for each run directory: a lock that the operating system drops when its holder dies.

The lock is a `flock`. A forked process would share it, and keep it when its parent has ended: so it is closed
there.
"""

from __future__ import annotations

import errno
import fcntl
import os
import platform
import re
import time
from pathlib import Path
from typing import Final
from weakref import WeakSet

from experiment_runner.store.database import reported
from glue.errors import ExperimentError
from glue.files import descriptor_of

LOCK_FILE: Final = "lock"

# `lock_holder` acquires the lock for an instant to see whether it is free.
_ATTEMPTS: Final = 5
_PAUSE: Final = 0.05
_LONGEST: Final = 200  # bytes of the file that are read
_LOCK: Final = re.compile(rb"(process \d+ on .*)?")  # empty if the disk was full
_NO_LOCKS: Final = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL)


class DirectoryTaken(ExperimentError):
    """A directory is in use, or holds something other than the wanted run.

    Attributes:
        directory: the directory.
    """

    def __init__(self, directory: Path, why: str) -> None:
        super().__init__(f"{directory} {why}")
        self.directory = directory


class NoLocks(ExperimentError):
    """The file system of a directory has no locks, so two programs could write to a run at the same time."""

    def __init__(self, directory: Path) -> None:
        super().__init__(
            f"the file system of {directory} has no locks (flock), which leave a run to one writer: "
            "use a directory on another file system"
        )


class RunLock:
    """Holds the lock of a run directory until `release`, or until the process ends.

    Raises:
        DirectoryTaken: another process holds it, which the message names; or the file is not a lock.
        NoLocks: the file system has none.
        StorageError: the lock file cannot be written.
    """

    def __init__(self, directory: Path) -> None:
        path = directory / LOCK_FILE
        with reported(f"cannot write {path}"):
            self._file = descriptor_of(path, os.O_RDWR | os.O_CREAT, 0o644)
            _held.add(self)
            try:
                self._take(directory, path)
            except BaseException:
                self.release()
                raise

    def _take(self, directory: Path, path: Path) -> None:
        content = os.pread(self._file, _LONGEST, 0)
        if not _LOCK.fullmatch(content):  # it would be overwritten
            raise DirectoryTaken(directory, f"has a file {LOCK_FILE} that is no run's lock: remove it")
        try:
            free = _try_lock(self._file, _ATTEMPTS)
        except NotImplementedError:
            if not content:
                path.unlink(missing_ok=True)
            raise NoLocks(directory) from None
        # A file that its last holder removed meanwhile locks nothing.
        if not free or not _is_open_as(self._file, path):
            raise DirectoryTaken(directory, f"is in use by {_name_in(self._file)}")
        os.truncate(self._file, 0)
        os.pwrite(self._file, f"process {os.getpid()} on {platform.node()}".encode(), 0)

    def release(self) -> None:
        """Let another process write. May be called twice."""
        if self._file >= 0:
            os.close(self._file)
        self._file = -1


def lock_holder(directory: Path) -> str | None:
    """Return the process that writes to a run directory, as in `process 42 on lab7`; None if none does."""
    try:
        file = descriptor_of(directory / LOCK_FILE, os.O_RDONLY)
    except OSError:
        return None
    try:
        return None if _try_lock(file, 1, fcntl.LOCK_SH) else _name_in(file)
    except NotImplementedError:  # then nothing can write to it
        return None
    finally:
        os.close(file)


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
        except OSError as error:
            if error.errno in _NO_LOCKS:
                raise NotImplementedError from None
            raise
        return True
    return False


def _name_in(file: int) -> str:
    return os.pread(file, _LONGEST, 0).decode(errors="replace") or "another process"


_held: Final[WeakSet[RunLock]] = WeakSet()


def _release_all() -> None:
    for lock in tuple(_held):
        lock.release()


os.register_at_fork(after_in_child=_release_all)
