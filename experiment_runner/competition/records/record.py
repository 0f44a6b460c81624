"""The record of a trial: an actions-only recording (docs/trajectories.md), as a file of the run.

The organiser's database holds the SHA-256 of each finished record, so no byte of it can change unnoticed.
"""

from __future__ import annotations

import hashlib
import os
import re
from pathlib import Path
from typing import BinaryIO, Final

from experiment_runner.plan.limits import TrialId
from experiment_runner.store.database import KEPT, reported
from experiment_runner.store.layout import RECORDS
from glue.closing import Closing
from glue.errors import ExperimentError
from glue.files import create_regular, open_regular

NAMES: Final = "up to 64 letters, digits and _ . + - are allowed, and the first is a letter, a digit or _"
"""The names of entrants and tasks that are allowed, for messages: each names folders."""

_NAME: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.+-]{0,63}")
_MOST_BYTES: Final = 2**32
"""Maximum size of a record that is read."""


def is_name(text: str) -> bool:
    """Return whether a task or an entrant can have this name; see `NAMES`."""
    return _NAME.fullmatch(text) is not None


class RecordFile(Closing):
    """A record that is being written.

    Args:
        path: path of the file; an existing one is replaced.

    Raises:
        StorageError: it cannot be written.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._hash = hashlib.sha256()
        with reported(f"cannot write {path}", KEPT):
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file: BinaryIO = create_regular(path)

    def append(self, piece: bytes) -> None:
        """Append a piece of the recording.

        Raises:
            StorageError: it cannot be written.
        """
        with reported(f"cannot write {self._path}", KEPT):
            self._file.write(piece)
            self._file.flush()
        self._hash.update(piece)

    def finish(self) -> bytes:
        """Flush the record to the disk, and close it; return its SHA-256.

        Raises:
            StorageError: it cannot be written.
        """
        with reported(f"cannot write {self._path}", KEPT):
            os.fsync(self._file.fileno())
        self.close()
        return self._hash.digest()

    def close(self) -> None:
        """Close the file as it is."""
        self._file.close()


def record_path(directory: Path, trial_id: str) -> Path:
    """Return the path of the record of a trial.

    Raises:
        ExperimentError: no trial of a competition has this id, which could lead out of the directory.
    """
    entrant, task, _ = TrialId(trial_id).parts
    if not (is_name(entrant) and is_name(task)):
        raise ExperimentError(f"{trial_id!r:.80} is not the id of a trial of a competition")
    return directory / RECORDS / f"{trial_id}.traj"


def digest(path: Path) -> bytes:
    """Return the SHA-256 of a record.

    Raises:
        StorageError: it cannot be read.
    """
    with reported(f"cannot read {path}"), open_regular(path, most=_MOST_BYTES) as file:
        return hashlib.file_digest(file, "sha256").digest()
