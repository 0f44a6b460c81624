"""Temporary folders, which the next run removes if the run that made them was killed."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from experiment_runner.store.database import StorageError
from experiment_runner.store.layout import LOCK_FILE, DirectoryTaken, NoLocks, RunLock, lock_holder
from glue.errors import ExperimentError

_PREFIX: Final = "glue-"
_OURS: Final = _PREFIX + 8 * "?"
"""Pattern of names made by `tempfile`."""

_MAX_PARENT: Final = 80
"""Bytes of the longest path of a folder in which sockets are made: the path of a socket has at most 107."""

_SHORT: Final = Path("/tmp")

SOCKET: Final = "hub"
"""Name of the Unix socket in such a folder."""


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Yield a new folder that only this user can enter, for the sockets of one trial.

    Raises:
        ExperimentError: the file system of temporary folders has no locks.
        OSError: it cannot be made.
    """
    parent = Path(tempfile.gettempdir())
    if len(os.fsencode(parent)) > _MAX_PARENT:
        parent = _SHORT
    _remove_abandoned(parent)
    folder, lock = _make(parent)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        lock.release()


def _make(parent: Path) -> tuple[Path, RunLock]:
    while True:
        folder = Path(tempfile.mkdtemp(prefix=_PREFIX, dir=parent))
        with suppress(DirectoryTaken):
            try:
                lock = RunLock(folder)
            except (NoLocks, StorageError) as error:
                shutil.rmtree(folder, ignore_errors=True)
                raise ExperimentError(f"{error}; TMPDIR=DIR sets that of temporary folders") from None
            if (folder / LOCK_FILE).exists():
                return folder, lock
            lock.release()
        # Before the folder was locked, another run removed it as abandoned.


def _remove_abandoned(parent: Path) -> None:
    for folder in parent.glob(_OURS):
        # Only folders that are certainly ours: other programs make folders in /tmp, too.
        with suppress(OSError, ExperimentError):
            ours = LOCK_FILE in (names := os.listdir(folder)) and {LOCK_FILE, SOCKET}.issuperset(names)
            if ours and folder.lstat().st_uid == os.getuid() and lock_holder(folder) is None:
                lock = RunLock(folder)
                shutil.rmtree(folder, ignore_errors=True)
                lock.release()
