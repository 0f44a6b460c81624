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
from typing import Any, BinaryIO, Final

import msgspec

from experiment_runner.store.database import KEPT, reported
from experiment_runner.store.layout import JOURNAL_FILE
from glue.errors import ExperimentError
from glue.files import descriptor_of, read_regular

ENTER: Final = "enter"
ADD: Final = "add"
EXCLUDE: Final = "exclude"
RERUN: Final = "rerun"
ENROL: Final = "enrol"
IMAGE: Final = "image"
REQUEST: Final = "request"
START: Final = "start"
OVER: Final = "over"
OURS: Final = "ours"
CANCEL: Final = "cancel"
WITHDRAW: Final = "withdraw"
GRANT: Final = "grant"
READMIT: Final = "readmit"
PAUSE: Final = "pause"
RESUME: Final = "resume"
FREEZE: Final = "freeze"
THAW: Final = "thaw"
ANNOUNCE: Final = "announce"
CHANGE: Final = "change"
CLOSE: Final = "close"

EVERYBODY: Final = "*"
"""Subject of an act that concerns the whole season; no entrant's name."""

_MOST_BYTES: Final = 2**28
_BLOCK: Final = 2**16


@dataclass(frozen=True, slots=True)
class Act:
    """One act.

    The subject of most acts is an entrant: `enter` at the start, `add` late, `enrol` by itself, or to get its
    `token` if it was admitted with a key; `exclude` and `readmit`; `pause` and `resume`, also of `EVERYBODY`;
    `grant` of further attempts; `image`, a new one.

    In a season, an attempt is named by its entrant and its number: `request` queues it, `start` lets it play,
    `over` says that every trial of it was played and verified. `ours` ends one for a reason that is not the
    entrant's, `cancel` one that waits; neither costs an attempt. `withdraw` is its owner's wish that it does
    not count. `rerun` queues an attempt that costs nothing, and counts instead of another.

    Outside a season, `rerun` is of a trial. `freeze`, `thaw`, `announce` and `close` are about the whole
    season, and `change` about one of its settings.

    Args:
        time: of the act, UTC, as in `2026-11-27T06:00:00Z`.
        act: its kind.
        subject: name of the entrant, id of the trial, name of the setting, or `EVERYBODY`.
        reason: in the organiser's words; of `over`, why the attempt was forfeited, empty if it was not.
        player: what an entrant's settings name: an image, a command, the file of a key, a folder.
        id: what that name stood for: the image's id or the public key. Empty if it can have none.
        trial: of a rerun of a trial: id of the trial that counts instead.
        alias: the entrant's pseudonym.
        team: its team; empty for none.
        token: SHA-256, in hexadecimal, of the token with which its owner sees more of the page.
        number: of the attempt, from 1; of a grant, the number of attempts.
        instead: of a rerun of an attempt: number of the attempt that no longer counts; of a request, of the
            attempt that is `ours`, and whose charge this one takes over.
        value: of a change, the setting's new value, as JSON; of a start, the number of the slot.
    """

    time: str
    act: str
    subject: str
    reason: str
    player: str = ""
    id: str = ""
    trial: str = ""
    alias: str = ""
    team: str = ""
    token: str = ""
    number: int = 0
    instead: int = 0
    value: str = ""

    @property
    def when(self) -> datetime:
        """The time of the act.

        Raises:
            ExperimentError: it is none.
        """
        try:
            found = datetime.strptime(self.time, _TIME).replace(tzinfo=UTC)
        except ValueError:
            found = datetime.min.replace(tzinfo=UTC)
        if not 1970 < found.year < 9999:  # every time zone has the others
            raise ExperimentError(f"the journal has an act at {self.time!r:.80}, which is not a time")
        return found

    @property
    def line(self) -> str:
        """The act as a line of a log."""
        number = f" {self.number}" if self.number else ""
        return f"{self.act} {self.subject}{number}" + (f": {self.reason}" if self.reason else "")


_ALWAYS: Final = ("time", "act", "subject", "reason")
_TIME: Final = "%Y-%m-%dT%H:%M:%SZ"


def utc_now() -> datetime:
    """Return the time."""
    return datetime.now(UTC)


def act(kind: str, subject: str, reason: str, *, now: datetime | None = None, **more: Any) -> Act:
    """Return an act of this moment.

    Args:
        kind: of the act.
        subject: of the act.
        reason: for it.
        now: the time; None reads the clock.
        more: further fields.
    """
    return Act(time_text(now or utc_now()), kind, subject, reason, **more)


def time_text(time: datetime) -> str:
    """Return a time as in `Act.time`."""
    return time.astimezone(UTC).strftime(_TIME)


def text_of(acts: Iterable[Act]) -> str:
    """Return the lines of acts, without the fields that are empty."""
    given = ({name: value for name, value in asdict(one).items() if value or name in _ALWAYS} for one in acts)
    return "".join(json.dumps(fields) + "\n" for fields in given)


def content(directory: Path) -> bytes:
    """Return the complete lines of a run's journal; empty if there is none.

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


def append(directory: Path, lines: bytes) -> None:
    """Append lines, in place of one that a killed process has left incomplete, and flush them to the disk.

    Raises:
        StorageError: the journal cannot be written.
    """
    path = directory / JOURNAL_FILE
    with (
        reported(f"cannot write {path}", KEPT),
        open(descriptor_of(path, os.O_RDWR | os.O_CREAT | os.O_APPEND), "a+b") as file,
    ):
        file.truncate(_whole(file))
        file.write(lines)
        file.flush()
        os.fsync(file.fileno())


def _whole(file: BinaryIO) -> int:
    """Return the size of the complete lines of a journal."""
    end = file.seek(0, os.SEEK_END)
    while end > 0:
        start = max(0, end - _BLOCK)
        file.seek(start)
        if (last := file.read(end - start).rfind(b"\n")) >= 0:
            return start + last + 1
        end = start
    return 0
