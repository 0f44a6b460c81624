"""The files of a run directory: creating all of them or none, and removing them.

A new run is written to a subfolder of the directory, and its files are then moved up, the database last.
Only then does the directory hold a run; a subfolder that a killed process leaves behind is ignored. Files
that were there before are never replaced or removed.

One writer for each run directory: a lock that the operating system drops when its holder dies.

The lock is a `flock`. A forked process would share it, and keep it when its parent has ended: so it is closed
there.

The hubs of a run's trials in progress: a file in its directory, for observers.

The file is written for each trial that has a hub, and removed with the last. A run may come from elsewhere,
so the contents are checked on reading: a hub belongs to this user, or is on this machine.
"""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import platform
import re
import shutil
import stat
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NamedTuple
from urllib.parse import urlsplit
from weakref import WeakSet

from experiment_runner.store.database import DATABASE_FILES, holds_run, reported
from glue.errors import ConfigError, ExperimentError
from glue.files import create_regular, descriptor_of, read_regular, read_text
from glue.hub.config import check_session, check_url

HUBS_FILE: Final = "hubs.json"
_MOST_BYTES: Final = 2**18
_LOOPBACK: Final = ("127.0.0.1", "::1", "localhost")


class LiveSession(NamedTuple):
    """The hub of a trial: its URL, and the session's name."""

    hub: str
    session: str


def put_live_sessions(directory: Path, live: Mapping[str, LiveSession]) -> None:
    """Write the hubs of the trials of a run in progress, by id, or remove the file if there are none.

    Best effort: only observers need it, so errors are ignored. Only the writer of the run may call it.
    """
    path = directory / HUBS_FILE
    new = path.with_name(f".{HUBS_FILE}.{os.getpid()}")
    with suppress(OSError):
        if not live:
            path.unlink(missing_ok=True)
            return
        with create_regular(new, mode=0o600) as file:
            file.write(json.dumps(live).encode())
        new.replace(path)


def live_sessions(directory: Path) -> dict[str, LiveSession]:
    """Return the hubs of the trials in progress, by id, that belong to this user or this machine."""
    try:
        fields: Any = json.loads(read_regular(directory / HUBS_FILE, _MOST_BYTES, own=True))
        found = {str(trial_id): LiveSession(hub, session) for trial_id, (hub, session) in fields.items()}
    except (OSError, ValueError, TypeError, AttributeError, RecursionError):
        return {}
    return {trial_id: live for trial_id, live in found.items() if _is_ours(live)}


def _is_ours(live: LiveSession) -> bool:
    """Return whether a hub is a socket of this user, or listens on this machine."""
    if not (isinstance(live.hub, str) and isinstance(live.session, str)):
        return False
    try:
        check_url(live.hub)
        check_session(live.session)
    except ConfigError:
        return False
    scheme, _, path = live.hub.partition("://")
    if scheme == "tcp":
        return urlsplit(live.hub).hostname in _LOOPBACK
    try:
        status = os.lstat(path)
    except (OSError, ValueError):
        return False
    return path.startswith("/") and stat.S_ISSOCK(status.st_mode) and status.st_uid == os.getuid()


LOCK_FILE: Final = "lock"

# `lock_holder` acquires the lock for an instant to see whether it is free.
_ATTEMPTS: Final = 5
_PAUSE: Final = 0.05
_LONGEST: Final = 200  # bytes of the file that are read
_LOCK: Final = re.compile(rb"(process \d+ on .*)?")  # empty if the disk was full
_NO_LOCKS: Final = (errno.ENOLCK, errno.ENOSYS, errno.ENOTSUP, errno.EOPNOTSUPP, errno.EINVAL)


class DirectoryTaken(ExperimentError):
    """A directory is in use, or holds something other than the wanted run."""

    def __init__(self, directory: Path, why: str) -> None:
        super().__init__(f"{directory} {why}")


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


PLAN_FILE: Final = "plan.toml"
ABOUT_FILE: Final = "run.json"
COMPETITION_FILE: Final = "competition.toml"
SOURCES: Final = "sources"  # a folder: copies of the user's files that the plan loads
JOURNAL_FILE: Final = "journal.jsonl"  # of a competition's run: the acts of its organiser
SEAL_FILE: Final = "seal.json"  # of a competition's run: digests of what its board shows
TOKEN_FILE: Final = "page.token"  # of a season: the secret with which its page shows all to the organiser
BOARD_FILE: Final = "board.json"  # of a bundle of a competition: its boards
NOTES_FILE: Final = "notes.json"  # a note and tags, which the page of runs takes
RECORDS: Final = "records"  # a folder of a competition's run: recordings of its trials
LOGS: Final = "logs"  # likewise: output of the entrants
PARTS: Final = "parts"  # a folder: shares of the trials, for the tasks of a job array
STREAMS: Final = "streams"  # a folder: the progress of loggers, and TensorBoard's files

_FILES: Final = (
    *DATABASE_FILES,
    *(PLAN_FILE, COMPETITION_FILE, JOURNAL_FILE, SEAL_FILE, BOARD_FILE, ABOUT_FILE, NOTES_FILE),
    *(TOKEN_FILE, HUBS_FILE, LOCK_FILE),
)
"""Files of a run, in the order of their removal: without the first, the rest does not count as a run."""

UNFINISHED: Final = ".unfinished"  # the subfolder in which a new run is written


@contextlib.contextmanager
def new_run(directory: Path) -> Iterator[tuple[Path, RunLock]]:
    """Create a run directory from the files that are put in the folder that is yielded; its lock stays held.

    On an exception everything that was created is removed, and the lock is released.

    Args:
        directory: created with its parents; if it exists, it must be empty.

    Raises:
        DirectoryTaken: the directory is not empty, or another process is creating a run in it.
        OSError: the directory cannot be written to.
    """
    made = not directory.exists()
    directory.mkdir(parents=True, exist_ok=True)
    had_lock = os.path.lexists(directory / LOCK_FILE)
    lock = None
    try:
        if not had_lock:
            _check_free(directory)
        lock = RunLock(directory)
        _check_free(directory)
        folder = directory / UNFINISHED
        shutil.rmtree(folder, ignore_errors=True)  # left by a process that was killed
        folder.mkdir()
        yield folder, lock
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


def copy_of(path: Path, sha256: str) -> str:
    """Return the place in a run of the copy of a file of the user's with this SHA-256, in hexadecimal."""
    return f"{SOURCES}/{sha256[:12]}-{path.name}"


def check_links(directory: Path) -> None:
    """Check that no folder below a run directory leads elsewhere, before files are written there.

    Raises:
        ExperimentError: one is a symbolic link, or holds one.
    """
    for name in (SOURCES, PARTS, STREAMS, RECORDS, LOGS):
        for folder, folders, files in os.walk(directory / name):
            for path in (Path(folder), *(Path(folder, each) for each in (*folders, *files))):
                if path.is_symlink():
                    raise ExperimentError(f"{path} is a symbolic link, which no run has: remove it")


def clear(directory: Path) -> None:
    """Remove the run in a directory, if there is one, to make way for another.

    Raises:
        DirectoryTaken: it holds other files, too, or another process writes to it. Then nothing is removed.
        ExperimentError: the run cannot be read, or not be removed.
    """
    with reported(f"cannot remove {directory}"):
        if not holds_run(directory):
            return
        own = {*_FILES, *_folders(directory)}
        for path in sorted(directory.iterdir()):
            if path.name not in own:
                raise _taken(directory, path.name)
    remove_run(directory)


def _folders(directory: Path) -> tuple[str, ...]:
    competes = (directory / COMPETITION_FILE).is_file()
    return (UNFINISHED, SOURCES, PARTS, STREAMS, *((RECORDS, LOGS) if competes else ()))


def remove_run(directory: Path) -> list[str]:
    """Remove a run, and its directory unless it holds anything else.

    Returns:
        The names of the other files, which stay.

    Raises:
        ExperimentError: there is no run, another process writes to it, or a file cannot be removed.
    """
    with reported(f"cannot remove {directory}"):
        if not holds_run(directory):
            raise ExperimentError(f"{directory} holds no run")
        lock = RunLock(directory)
        try:
            folders = _folders(directory)
            for name in _FILES:
                (directory / name).unlink(missing_ok=True)
            for name in folders:
                shutil.rmtree(directory / name, ignore_errors=True)
        finally:
            lock.release()
        left = sorted(path.name for path in directory.iterdir())
        if not left:
            directory.rmdir()
    return left


def runs_under(folder: Path) -> Iterator[Path]:
    """Yield the directories under a folder, or the folder itself, that look like runs, sorted by name."""
    for path, folders, files in os.walk(folder):
        folders[:] = sorted(name for name in folders if name != UNFINISHED)
        if DATABASE_FILES[0] in files:
            folders.clear()
            yield Path(path)


def parts_of(directory: Path) -> list[Path]:
    """Return the shares of a run's trials that tasks of a job array continue, each a run, by number.

    Raises:
        ExperimentError: the database of one cannot be read.
    """
    numbered = [path for path in (directory / PARTS).glob("*") if path.name.isdecimal()]
    return [path for path in sorted(numbered, key=lambda path: int(path.name)) if is_run(path)]


def is_part(directory: Path) -> bool:
    """Return whether a run is a share of another run's trials.

    Raises:
        ExperimentError: the database of the other run cannot be read.
    """
    folder = directory.absolute().parent
    return folder.name == PARTS and is_run(folder.parent)


def is_run(directory: Path) -> bool:
    """Return whether a directory holds a run.

    Raises:
        ExperimentError: its database cannot be read.
    """
    with reported(f"cannot read {directory}"):
        return holds_run(directory)


def read_about(directory: Path) -> dict[str, Any]:
    """Return the contents of a run's `run.json`, its provenance; empty if there is none.

    Raises:
        ExperimentError: it is not a JSON object, is nested too deeply or is too large.
    """
    path = directory / ABOUT_FILE
    if not os.path.lexists(path):
        return {}
    try:
        about = json.loads(read_text(path), parse_constant=_refuse)
        if not isinstance(about, dict):
            raise ValueError("it is not a JSON object")
    except RecursionError:
        raise ExperimentError(f"cannot read {path}: it is nested too deeply") from None
    except OSError as error:
        raise ExperimentError(f"cannot read {path}: {error.strerror}") from None
    except ValueError as error:
        raise ExperimentError(f"cannot read {path}: {error}") from None
    return about


def _refuse(constant: str) -> None:
    raise ValueError(f"{constant} is not a number of JSON")


def write_flushed(path: Path, content: str | bytes) -> None:
    """Write a file and flush it to the disk."""
    path.parent.mkdir(exist_ok=True)
    with create_regular(path) as file:
        file.write(content.encode() if isinstance(content, str) else content)
        file.flush()
        os.fsync(file.fileno())


def replace_flushed(path: Path, content: str | bytes, hint: str = "") -> None:
    """Write a file of a run in place of an existing one, as a whole; a link there is replaced, not followed.

    Args:
        path: path of the file.
        content: its new contents.
        hint: remedy for an error; see `reported`.

    Raises:
        StorageError: it cannot be written.
    """
    with reported(f"cannot write {path}", hint), tempfile.TemporaryDirectory(dir=path.parent) as made:
        new = Path(made) / path.name
        write_flushed(new, content)
        new.replace(path)


def _check_free(directory: Path) -> None:
    if holds_run(directory):
        raise DirectoryTaken(directory, "holds a run")
    for path in directory.iterdir():
        if path.name not in (LOCK_FILE, UNFINISHED):
            raise _taken(directory, path.name)


def _taken(directory: Path, name: str) -> DirectoryTaken:
    return DirectoryTaken(directory, f"is not empty: it holds {name}, and a run needs a directory of its own")


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
            if path.is_dir():
                shutil.rmtree(path, ignore_errors=True)
            else:
                path.unlink(missing_ok=True)
        raise


def _flush_names(directory: Path) -> None:
    handle = os.open(directory, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
