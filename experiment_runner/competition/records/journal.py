"""The journal of a competition: every act of its organiser, in a file to which lines are only appended.

Each line of `journal.jsonl` is a JSON object, see `Act`. The journal and the records of the trials determine
the board. An act deletes nothing, and none is taken back.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

import msgspec

from experiment_runner.store.database import KEPT, reported
from experiment_runner.store.layout import JOURNAL_FILE
from glue.errors import ExperimentError
from glue.files import descriptor_of, read_regular

ENTER: Final = "enter"
ADD: Final = "add"
EXCLUDE: Final = "exclude"
RERUN: Final = "rerun"

_MOST_BYTES: Final = 2**24


@dataclass(frozen=True, slots=True)
class Act:
    """One act.

    Args:
        time: of the act, UTC, as in `2026-11-27T06:00:00Z`.
        act: `enter`, an entrant at the start; `add`, one who came late; `exclude`, an entrant; `rerun`, a
            trial.
        subject: name of the entrant, or id of the trial.
        reason: in the organiser's words.
        player: what an entrant's settings name: an image, a command, the file of a key, a folder.
        id: what that name stood for: the image's id or the public key. Empty if it can have none.
        trial: of a rerun: id of the trial that counts instead.
    """

    time: str
    act: str
    subject: str
    reason: str
    player: str = ""
    id: str = ""
    trial: str = ""


def act(kind: str, subject: str, reason: str, **more: str) -> Act:
    """Return an act of this moment."""
    return Act(datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ"), kind, subject, reason, **more)


def text_of(acts: Iterable[Act]) -> str:
    """Return the lines of acts."""
    return "".join(json.dumps(asdict(one)) + "\n" for one in acts)


def content(directory: Path) -> bytes:
    """Return the complete lines of a run's journal; empty if there is none, as in a run of version 0.3.

    Raises:
        StorageError: it cannot be read.
    """
    path = directory / JOURNAL_FILE
    with reported(f"cannot read {path}"):
        try:
            text = read_regular(path, _MOST_BYTES)
        except FileNotFoundError:
            return b""
    return text[: text.rfind(b"\n") + 1]


def acts_of(directory: Path) -> list[Act]:
    """Return the acts of a run, oldest first.

    Raises:
        ExperimentError: the journal cannot be read.
    """
    try:
        return msgspec.json.Decoder(Act).decode_lines(content(directory))
    except (ValueError, RecursionError) as error:
        raise ExperimentError(f"{directory / JOURNAL_FILE} is not a journal: {error}") from None


def append(directory: Path, acts: Iterable[Act]) -> None:
    """Append acts, in place of a line that a killed process has left incomplete, and flush them to the disk.

    Raises:
        StorageError: the journal cannot be written.
    """
    whole = len(content(directory))
    path = directory / JOURNAL_FILE
    with (
        reported(f"cannot write {path}", KEPT),
        open(descriptor_of(path, os.O_WRONLY | os.O_CREAT | os.O_APPEND), "ab") as file,
    ):
        file.truncate(whole)
        file.write(text_of(acts).encode())
        file.flush()
        os.fsync(file.fileno())
