"""The client under test, as a process."""

from __future__ import annotations

import os
import signal
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Final, Protocol

from glue.errors import ConfigError

TRANSPORTS: Final = ("tcp", "ipc")
"""Schemes of the addresses at which the kit listens."""


class Client(Protocol):
    """A started client."""

    def wait(self, seconds: float) -> int | None:
        """Return the exit code, negative for a signal; None if the client does not end within `seconds`."""

    def kill(self) -> None:
        """Kill the client."""

    def output(self) -> str:
        """Return the client's output so far."""

    def awake(self) -> bool | None:
        """Return whether the client is running or runnable; None if unknown."""


Start = Callable[[str, str], Client]
"""A function that starts a client, given a hub's address and a session."""


def starter(command: Sequence[str]) -> Start:
    """Return a function that starts `command` with GLUE_HUB and GLUE_SESSION."""

    return lambda hub, session: ClientProcess(command, {"GLUE_HUB": hub, "GLUE_SESSION": session})


class ClientProcess:
    """A process with its children.

    Raises:
        ConfigError: the program cannot be started.
    """

    def __init__(self, command: Sequence[str], variables: dict[str, str]) -> None:
        self._printed = tempfile.TemporaryFile()  # noqa: SIM115
        try:
            self._process = subprocess.Popen(
                command,
                env={**os.environ, **variables},
                stdin=subprocess.DEVNULL,
                stdout=self._printed,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )
        except OSError as error:
            self._printed.close()
            raise ConfigError(f"cannot start {command[0]!r}: {error.strerror}; check the command") from None

    def wait(self, seconds: float) -> int | None:
        with suppress(subprocess.TimeoutExpired):
            return self._process.wait(seconds)
        return None

    def kill(self) -> None:
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._printed.close()

    def output(self) -> str:
        if self._printed.closed:
            return ""
        self._printed.seek(0)
        text = self._printed.read().decode(errors="replace")
        self._printed.seek(0, os.SEEK_END)
        return text

    def awake(self) -> bool | None:
        return is_awake(self._process.pid)


def is_awake(pid: int | None) -> bool | None:
    """Return whether a thread of a process is running or runnable; None where the system does not say."""
    try:
        stats = [(task / "stat").read_text() for task in Path(f"/proc/{pid}/task").iterdir()]
    except OSError:
        return None
    return any(stat.rpartition(")")[2].split()[0] == "R" for stat in stats)
