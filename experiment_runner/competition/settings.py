"""What a competition is: its tasks, its entrants and their limits. `file` reads it from TOML."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from glue.core.config import TimeLimits
from glue.options import Value

__all__ = ["Competition", "Entrant", "Gate", "Limits", "Task"]

_MEBIBYTE = 2**20


@dataclass(frozen=True, slots=True)
class Limits:
    """What an entrant may use in each trial of a task. Those of memory, processors, processes and disks hold
    for containers; a trusted command has this machine.

    Args:
        time: per answer, per task and to start; see `glue.core.config.TimeLimits`.
        memory: bytes, swap included.
        cpus: cores.
        pids: processes and threads.
        tmp: bytes of files in /tmp.
        shm: bytes of shared memory.
        log: bytes kept of what it prints.
    """

    time: TimeLimits = field(default_factory=TimeLimits)
    memory: int = 1024 * _MEBIBYTE
    cpus: float = 1.0
    pids: int = 128
    tmp: int = 64 * _MEBIBYTE
    shm: int = 64 * _MEBIBYTE
    log: int = _MEBIBYTE


@dataclass(frozen=True, slots=True)
class Task:
    """An environment, and how long it is played.

    Args:
        name: unique among the tasks.
        env: the environment's name, `module:Class` or `path/file.py:Class`.
        options: its constructor options, as given: without what is drawn from the secret seed.
        episodes: number of episodes; 0 if `steps` limits the task.
        steps: number of steps, over as many episodes as it takes; 0 if `episodes` limits the task.
    """

    name: str
    env: str
    options: Mapping[str, Value] = field(default_factory=dict)
    episodes: int = 0
    steps: int = 0


@dataclass(frozen=True, slots=True)
class Entrant:
    """Who takes part, and how it is started: one of the four is given.

    Args:
        name: unique among the entrants.
        image: a container image.
        command: a program of this machine and its arguments, which is trusted.
        key: the file of the public key of somebody who connects from elsewhere.
        folder: a folder in reach of programs that something else starts, as compose does: one for each trial,
            which finds the socket `hub` in a folder of its own in it, `TASK-TRIAL`.
    """

    name: str
    image: str | None = None
    command: tuple[str, ...] = ()
    key: Path | None = None
    folder: Path | None = None

    @property
    def player(self) -> str:
        """What plays, for people: the image, the command, the folder, or the file of the key."""
        if self.image is not None:
            return self.image
        if self.folder is not None:
            return str(self.folder)
        return " ".join(self.command) if self.key is None else self.key.name


@dataclass(frozen=True, slots=True)
class Gate:
    """Where entrants from elsewhere connect.

    Args:
        bind: URL that the hub listens on for them.
        keys: the directory with the hub's own pair of keys, see `glue.keys.allowed`.
    """

    bind: str
    keys: Path


@dataclass(frozen=True, slots=True)
class Competition:
    """A competition.

    Args:
        name: for people.
        trials: how often every entrant plays every task.
        tasks: in the order of the file.
        entrants: in the order of the file.
        limits: the same for all.
        seed_file: the file of the secret seed; None if it is in an environment variable.
        seed_env: the environment variable of the secret seed; None if it is in a file.
    """

    name: str
    trials: int
    tasks: tuple[Task, ...]
    entrants: tuple[Entrant, ...]
    limits: Limits = field(default_factory=Limits)
    seed_file: Path | None = None
    seed_env: str | None = None
