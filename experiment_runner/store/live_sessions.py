"""The hubs of a run's trials in progress: a file in its directory, for observers.

The file is written for each trial that has a hub, and removed with the last. A run may come from elsewhere,
so the contents are checked on reading: a hub belongs to this user, or is on this machine.
"""

from __future__ import annotations

import json
import os
import stat
from contextlib import suppress
from pathlib import Path
from typing import Any, Final, NamedTuple
from urllib.parse import urlsplit

from glue.errors import ConfigError
from glue.files import create_regular, read_regular
from glue.hub.config import check_session, check_url

HUBS_FILE: Final = "hubs.json"
_MOST_BYTES: Final = 2**18
_LOOPBACK: Final = ("127.0.0.1", "::1", "localhost")


class LiveSession(NamedTuple):
    """The hub of a trial: its URL, and the session's name."""

    hub: str
    session: str


class LiveSessions:
    """The file of a run, kept up to date by its only writer. Best effort: only observers need it, so write
    errors are ignored.

    Args:
        directory: the run directory.
    """

    def __init__(self, directory: Path) -> None:
        self._path = directory / HUBS_FILE
        self._live: dict[str, LiveSession] = {}
        self._write()  # removes the file of a killed process

    def begin(self, trial_id: str, live: LiveSession) -> None:
        """Record the hub of a trial."""
        self._live[trial_id] = live
        self._write()

    def end(self, trial_id: str) -> None:
        """Remove the hub of a trial."""
        if self._live.pop(trial_id, None) is not None:
            self._write()

    def close(self) -> None:
        """Remove the file."""
        self._live.clear()
        self._write()

    def _write(self) -> None:
        new = self._path.with_name(f".{HUBS_FILE}.{os.getpid()}")
        with suppress(OSError):
            if not self._live:
                self._path.unlink(missing_ok=True)
                return
            with create_regular(new, mode=0o600) as file:
                file.write(json.dumps(self._live).encode())
            new.replace(self._path)


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
