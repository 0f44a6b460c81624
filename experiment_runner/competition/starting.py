"""The start of an entrant's program for one trial of a task: an interface for all kinds of entrants.

An entrant is launched with a directory that holds the Unix socket `hub`, on which the hub of this trial
admits only the agent of one session. Nothing else connects the entrant with the competition.

`programs` starts trusted commands on this machine, `outside` waits for entrants from elsewhere, and
`containers` starts images.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, Protocol

from experiment_runner.competition.settings import Entrant, Limits

SOCKET: Final = "hub"
"""Name of the hub's Unix socket in a launch's folder."""


@dataclass(frozen=True, slots=True)
class Launch:
    """The launch settings of an entrant's program for one trial of a task.

    Args:
        folder: a directory that holds only the socket `hub`.
        session: the session's name.
        log: the file that receives the output of the entrant, at most `Limits.log` bytes.
        run: id of the run among all runs on this machine, by which its leftovers are found.
    """

    folder: Path
    session: str
    log: Path
    run: str

    @property
    def hub(self) -> str:
        """URL of the hub, on this machine."""
        return f"ipc://{self.folder / SOCKET}"


class Running(Protocol):
    """An entrant's program, started for one trial.

    Attributes:
        log: the file that receives its output.
        lost: why its trial says nothing about the entrant, and is to be played again; None if it does.
        offence: why its trial is forfeited although it was played to the end; None if it is not. Final once
            the program was stopped.
    """

    log: Path
    lost: str | None
    offence: str | None

    @property
    def reason(self) -> str | None:
        """Reason of its end, as in `ended with status 1` or `used more than 1024 MiB of memory`; None while
        it is alive."""
        ...

    def wait(self, seconds: float) -> bool:
        """Wait until the program ends, or for this many seconds; return whether it has ended."""
        ...

    def stop(self) -> None:
        """End the program and its children, and release its resources; may be called twice."""
        ...


class Starter(Protocol):
    """Starts entrants of one kind."""

    def check(self, entrant: Entrant, limits: Limits) -> str:
        """Check, before a run begins or continues, that the entrant can be started; return its `Entrant.id`.

        Raises:
            ConfigError: it cannot; the message is one line that says what to do, and does not name it.
        """
        ...

    def start(self, entrant: Entrant, limits: Limits, launch: Launch) -> Running:
        """Start the entrant's program, a new one in each trial.

        The program must end when this process ends, for whatever reason.

        Raises:
            ExperimentError: it cannot be started, for a reason that is not the entrant's.
        """
        ...

    def sweep(self, run: str) -> None:
        """End programs that a killed organiser of this run left running."""
        ...


def name_of_run(directory: Path) -> str:
    """Return the id of a run among all runs on this machine: `Launch.run`.

    Only the holder of the directory's lock starts entrants under this name, so containers that have it when a
    run begins were left behind by a process that was killed.
    """
    return hashlib.sha256(os.fsencode(directory.absolute())).hexdigest()[:16]


def variables(hub: str, session: str) -> Mapping[str, str]:
    """Return the environment variables by which an entrant's program finds its hub and its session."""
    return {"GLUE_HUB": hub, "GLUE_SESSION": session}
