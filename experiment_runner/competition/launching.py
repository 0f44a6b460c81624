"""The start of an entrant's program for one trial of a task: one interface for all kinds of entrants.

An entrant is launched with a directory that holds the Unix socket `hub`, on which the hub of this trial
admits only the agent of one session. Nothing else connects the entrant with the competition.

Here are trusted commands on this machine, and entrants whose programs are started elsewhere: on another
machine, or with access to a folder. `containers` starts images.
"""

from __future__ import annotations

import hashlib
import os
import resource
import shutil
import subprocess
import threading
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from experiment_runner.competition.settings import Entrant, Gate, Limits
from experiment_runner.competition.supervisor import CANNOT_START, MODULE
from experiment_runner.processes.children import how_it_ended, spawn
from experiment_runner.store.database import reported
from experiment_runner.store.layout import write_flushed
from glue.errors import ConfigError, ExperimentError
from glue.hub.config import Bind, Keys, Permit
from glue.installed import needing
from glue.keys.allowed import HUB
from glue.keys.certificates import SECRET, encode, read_pair, read_public
from glue.wire.messages import Role

SOCKET: Final = "hub"
"""Name of the hub's Unix socket in a launch's folder."""

_KIBIBYTE: Final = 1024

_STOP_SECONDS: Final = 5.0
"""Time for a supervisor to end its program."""


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


class Running:
    """An entrant's program, started for one trial. This one is on another machine, where only its connection
    shows whether it is alive.

    Attributes:
        reason: how it ended, as in `ended with status 1` or `used more than 1024 MiB of memory`; None until
            `wait` has found that it has.
        lost: why its trial says nothing about the entrant, and is to be played again; None if it does.
        offence: why its trial is forfeited although it was played to the end; None if it is not. Final once
            the program was stopped.
    """

    def __init__(self) -> None:
        self.reason: str | None = None
        self.lost: str | None = None
        self.offence: str | None = None
        self._over = threading.Event()

    def wait(self, seconds: float) -> bool:
        """Wait until the program ends, or for this many seconds; return whether it has ended."""
        self._over.wait(seconds)
        return self.reason is not None

    def stop(self) -> None:
        """End the program and its children, and release its resources; may be called twice."""
        self._over.set()

    @property
    def processor(self) -> float | None:
        """Seconds that it has used of all processors so far; None if unknown."""
        return None

    @property
    def peak(self) -> int | None:
        """The most bytes of memory that it has used at once; None if unknown."""
        return None

    def _offend(self, how: str) -> None:
        self.offence = how
        self._end(how)

    def _lose(self, why: str) -> None:
        if self.reason is None:
            self.lost = why
        self._end(why)

    def _end(self, reason: str) -> None:
        self.reason = self.reason or reason
        self._over.set()


class Launcher:
    """Starts entrants of one kind."""

    def check(self, entrant: Entrant, limits: Limits) -> str:
        """Check, before a run begins or continues, that the entrant can be started; return its `Entrant.id`.

        Raises:
            ConfigError: it cannot; the message is one line that says what to do, and does not name it.
            ExperimentError: this cannot be found out.
        """
        return ""

    def start(self, entrant: Entrant, limits: Limits, launch: Launch) -> Running:
        """Start the entrant's program, a new one in each trial.

        The program must end when this process ends, for whatever reason.

        Raises:
            ExperimentError: it cannot be started, for a reason that is not the entrant's.
        """
        raise NotImplementedError

    def sweep(self, run: str) -> None:
        """End programs that a killed organiser of this run left running.

        Raises:
            ConfigError, ExperimentError: they cannot be ended.
        """


def launcher_for(entrant: Entrant) -> Launcher:
    """Return the launcher for an entrant of this kind.

    Raises:
        ConfigError: it needs a package that is not installed.
    """
    if entrant.image is not None:
        with needing("compete", f"entrant {entrant.name} has an image, and containers need Docker's SDK"):
            from experiment_runner.competition.containers import Containers
        return Containers()
    if entrant.key is not None:
        return Outside()
    return InFolder() if entrant.folder is not None else Programs()


def name_of_run(directory: Path) -> str:
    """Return the id of a run among all runs on this machine: `Launch.run`.

    Only the holder of the directory's lock starts entrants under this name, so containers that have it when a
    run begins were left behind by a process that was killed.
    """
    return hashlib.sha256(os.fsencode(directory.absolute())).hexdigest()[:16]


def variables(hub: str, session: str) -> Mapping[str, str]:
    """Return the environment variables by which an entrant's program finds its hub and its session."""
    return {"GLUE_HUB": hub, "GLUE_SESSION": session}


class Programs(Launcher):
    """Starts trusted commands."""

    def check(self, entrant: Entrant, limits: Limits) -> str:
        """Check that the program exists."""
        if shutil.which(entrant.command[0]) is None:
            raise ConfigError(
                f"there is no program {entrant.command[0]!r} here: install it, or name it with its path"
            )
        return ""

    def start(self, entrant: Entrant, limits: Limits, launch: Launch) -> Running:
        """Start the command, below a supervisor."""
        arguments = [str(launch.log), str(limits.log), *entrant.command]
        try:
            return _Program(
                spawn(MODULE, arguments, env={**os.environ, **variables(launch.hub, launch.session)})
            )
        except OSError as error:
            raise ExperimentError(f"cannot start {entrant.name}: {error}") from error


class _Program(Running):
    def __init__(self, supervisor: subprocess.Popen[bytes]) -> None:
        super().__init__()
        self._supervisor = supervisor
        # A worker plays one match at a time.
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        self._before = before.ru_utime + before.ru_stime

    def wait(self, seconds: float) -> bool:
        with suppress(subprocess.TimeoutExpired):
            status = self._supervisor.wait(seconds)
            self.reason = (
                "could not be started, or has ended with status 127: its log says more"
                if status == CANNOT_START
                else how_it_ended(status)
            )
        return self.reason is not None

    def stop(self) -> None:
        assert self._supervisor.stdin is not None
        self._supervisor.stdin.close()
        if not self.wait(_STOP_SECONDS):
            self._supervisor.kill()
            self._supervisor.wait()

    @property
    def processor(self) -> float | None:
        """As of any program, once it has ended: the system counts only then."""
        if self.reason is None:
            return None
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        return used.ru_utime + used.ru_stime - self._before

    @property
    def peak(self) -> int | None:
        """As of any program, once it has ended, of its largest process."""
        if self.reason is None:
            return None
        return resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * _KIBIBYTE


class Outside(Launcher):
    """Waits for entrants that are admitted by their key, at one address, and play one at a time.

    Meanwhile the others find no hub there, or their session is refused, so their programs have to be
    restarted until the competition is over.
    """

    def check(self, entrant: Entrant, limits: Limits) -> str:
        """Return the public key, from its file unless the entrant has been admitted with it."""
        if entrant.id:
            return entrant.id
        if entrant.key is None or not entrant.key.is_file():
            raise ConfigError(
                f"there is no key {entrant.key}: ask its owner for the public key that glue-keys new has made"
            )
        return encode(read_public(entrant.key, "key"))

    def start(self, entrant: Entrant, limits: Limits, launch: Launch) -> Running:
        """Write to the log that the program is started elsewhere."""
        with reported(f"cannot write {launch.log}"):
            write_flushed(
                launch.log, f"{entrant.name} is not started here: its log is where its program is\n"
            )
        return Running()


class InFolder(Outside):
    """Waits for entrants that find the hub's socket in a folder; access to the folder admits them."""

    def check(self, entrant: Entrant, limits: Limits) -> str:
        """Check that the folder exists."""
        if entrant.folder is None or not entrant.folder.is_dir():
            raise ConfigError(
                f"there is no folder {entrant.folder}: make it, and give only the entrant's program access"
            )
        return ""

    def start(self, entrant: Entrant, limits: Limits, launch: Launch) -> Running:
        """Let any user connect; write to the log that the program is started elsewhere."""
        (launch.folder / SOCKET).chmod(0o666)
        return super().start(entrant, limits, launch)


def no_gate(why: str) -> ConfigError:
    """Return the error that there is no address for entrants with keys, and why there has to be one."""
    return ConfigError(
        f"{why}: give the directory of the hub's own pair (made by glue-keys new {HUB}), and an address to "
        "listen on",
        settings=("keys", "bind"),
    )


def gate_for(entrant: Entrant, gate: Gate | None) -> Bind:
    """Return the address at which only the owner of an entrant's key can join, as its agent.

    Raises:
        ConfigError: there is no gate, or a key cannot be read.
    """
    if gate is None or entrant.key is None:
        raise no_gate(f"entrant {entrant.name} joins with a key")
    agent, session = frozenset({Role.AGENT}), frozenset({entrant.name})
    pair = read_pair(gate.keys / f"{HUB}{SECRET}", "keys")
    permit = Permit(entrant.name, agent, session)
    return Bind(
        gate.bind, agent, session, Keys(pair.secret, {read_public(entrant.id or entrant.key, "key"): permit})
    )
