"""Temporary folders, which the next run removes if the run that made them was killed."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Final

from experiment_runner.store.lock import LOCK_FILE, RunLock, lock_holder
from glue.errors import ExperimentError
from glue.hub.io.listener import is_left_over

_PREFIX: Final = "glue-"
_OURS: Final = _PREFIX + 8 * "?"
"""Pattern of names made by `tempfile`. Checking a folder may mean connecting to its socket."""

SOCKET: Final = "hub"
"""Name of the Unix socket in such a folder."""


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Yield a new folder that only this user can enter, for the sockets of one trial.

    Raises:
        OSError: it cannot be made.
    """
    parent = Path(tempfile.gettempdir())
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
        with suppress(ExperimentError):
            lock = RunLock(folder)
            if (folder / LOCK_FILE).exists():
                return folder, lock
            lock.release()
        # Before the folder was locked, another run removed it as abandoned.


def _remove_abandoned(parent: Path) -> None:
    for folder in parent.glob(_OURS):
        # Only folders that are certainly ours: other programs make folders in /tmp, too.
        with suppress(OSError, ExperimentError):
            names = {path.name for path in folder.iterdir()}
            if folder.lstat().st_uid != os.getuid() or not names <= {LOCK_FILE, SOCKET}:
                continue
            if LOCK_FILE in names:
                abandoned = lock_holder(folder) is None
            else:  # of version 0.1.0, which had no lock
                abandoned = is_left_over(str(folder / SOCKET))
            if abandoned:
                lock = RunLock(folder)
                shutil.rmtree(folder, ignore_errors=True)
                lock.release()
