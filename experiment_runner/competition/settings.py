"""The settings of a competition: tasks, entrants and their limits. `file` reads them from TOML."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from glue.hub.config import TimeLimits
from glue.options import Value

_MEBIBYTE = 2**20


@dataclass(frozen=True, slots=True)
class Limits:
    """Limits of an entrant in each trial of a task. Those of memory, processors, processes and disks hold
    only for containers; a trusted command may use all of this machine.

    Args:
        time: per answer, per task and to start; see `glue.hub.config.TimeLimits`.
        memory: bytes, swap included.
        cpus: cores.
        pids: processes and threads.
        tmp: bytes of files in /tmp.
        shm: bytes of shared memory.
        log: bytes of its output that are kept.
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
    """An environment, and the number of episodes or steps to play.

    Args:
        name: unique among the tasks.
        env: the environment's name, `module:Class` or `path/file.py:Class`.
        options: its constructor options, as in the file, without those drawn from the secret seed.
        episodes: number of episodes; 0 if `steps` limits the task.
        steps: number of steps, over as many episodes as it takes; 0 if `episodes` limits the task.
        max_steps: the step limit of an episode, see `Experiment.rl_episode`; 0 for none.
    """

    name: str
    env: str
    options: Mapping[str, Value] = field(default_factory=dict)
    episodes: int = 0
    steps: int = 0
    max_steps: int = 0


@dataclass(frozen=True, slots=True)
class Entrant:
    """An entrant, and how it is started: exactly one of image, command, key and folder is given.

    Args:
        name: unique among the entrants.
        image: a container image.
        command: a trusted program on this machine, and its arguments.
        key: the file of the public key of an entrant that connects from elsewhere.
        folder: a folder for programs that another tool starts, such as compose: one program for each trial,
            which finds the socket `hub` in the subfolder `TASK-TRIAL`.
        id: what the name stood for when the entrant was admitted, and stands for throughout the run: the id
            of its image, or its public key. Empty for others, and before that.
    """

    name: str
    image: str | None = None
    command: tuple[str, ...] = ()
    key: Path | None = None
    folder: Path | None = None
    id: str = ""

    @property
    def player(self) -> str:
        """The player, for display: image, command, folder, or file of the key."""
        if self.image is not None:
            return self.image
        if self.folder is not None:
            return str(self.folder)
        return " ".join(self.command) if self.key is None else self.key.name


@dataclass(frozen=True, slots=True)
class Gate:
    """The address at which entrants from elsewhere connect.

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
        name: for display.
        trials: number of times that every entrant plays every task.
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
