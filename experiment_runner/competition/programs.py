"""Entrants that are trusted commands on this machine."""

from __future__ import annotations

import os
import shutil
import subprocess
from contextlib import suppress
from pathlib import Path
from typing import Final

from experiment_runner.competition.keeper import CANNOT_START, MODULE
from experiment_runner.competition.settings import Entrant, Limits
from experiment_runner.competition.starting import Launch, variables
from experiment_runner.processes.children import how_it_ended
from experiment_runner.processes.watchdog import spawn
from glue.errors import ConfigError, ExperimentError

_STOP_SECONDS: Final = 5.0
"""Time for a keeper to end its program."""


class Programs:
    """Starts trusted commands; see `experiment_runner.competition.starting.Starter`."""

    def check(self, entrant: Entrant, limits: Limits) -> str:
        """Check that the program exists."""
        if shutil.which(entrant.command[0]) is None:
            raise ConfigError(
                f"there is no program {entrant.command[0]!r} here: install it, or name it with its path"
            )
        return ""

    def start(self, entrant: Entrant, limits: Limits, launch: Launch) -> _Program:
        """Start the command."""
        return _Program(entrant, limits, launch)

    def sweep(self, run: str) -> None:
        """Do nothing: a program ends with the process that started it."""


class _Program:
    """A command and its keeper, see `experiment_runner.competition.keeper`."""

    lost: str | None = None
    offence: str | None = None

    def __init__(self, entrant: Entrant, limits: Limits, launch: Launch) -> None:
        self.log: Path = launch.log
        arguments = [str(launch.log), str(limits.log), *entrant.command]
        try:
            self._keeper = spawn(
                MODULE, arguments, env={**os.environ, **variables(launch.hub, launch.session)}
            )
        except OSError as error:
            raise ExperimentError(f"cannot start {entrant.name}: {error}") from error

    @property
    def reason(self) -> str | None:
        """Exit status in words; None while the program is alive."""
        status = self._keeper.poll()
        if status is None:
            return None
        if status == CANNOT_START:
            return "could not be started, or has ended with status 127: its log says more"
        return how_it_ended(status)

    def wait(self, seconds: float) -> bool:
        """Wait until the program ends, or for this many seconds; return whether it has ended."""
        with suppress(subprocess.TimeoutExpired):
            self._keeper.wait(seconds)
        return self._keeper.returncode is not None

    def stop(self) -> None:
        """End the program, with its process group."""
        assert self._keeper.stdin is not None
        self._keeper.stdin.close()
        if not self.wait(_STOP_SECONDS):
            self._keeper.kill()
            self._keeper.wait()
