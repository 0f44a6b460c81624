"""The jail of an entrant: the settings with which a container engine runs an unreviewed image.

A jail has no network. Its only way out is the directory with the hub's socket, mounted read-only. Its file
system is read-only too, except for a small /tmp in memory, and memory, processors and processes are limited.
Its programs have no privileges and cannot gain any, and can make only the system calls of `seccomp.json`.
docs/security.md names the attack that each setting prevents.
"""

from __future__ import annotations

import re
import socket
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Final

from experiment_runner.competition.launching import SOCKET, Launch, variables
from experiment_runner.competition.settings import Limits
from glue.console import one_line
from glue.errors import ConfigError, ExperimentError

LABEL: Final = "glue.competition"
"""Label of our containers: the run that they belong to."""

_FOLDER: Final = "/run/glue"
"""Mount point of the directory with the hub's socket."""

_HUB: Final = f"ipc://{_FOLDER}/{SOCKET}"

_SECCOMP: Final = Path(__file__).with_name("seccomp.json")
"""The system calls of a jail, in Docker's format. Not among them are `AF_VSOCK`, `io_uring` and others that
the default of Docker 20.10 allows."""

_MASKED: Final = tuple(
    f"/proc/{name}"
    for name in (
        *("acpi", "asound", "kcore", "keys", "latency_stats", "sched_debug", "scsi", "timer_list"),
        *("timer_stats", "kallsyms", "kpagecount", "kpageflags"),
        # The load of the whole machine, through which entrants could watch and signal each other.
        *("loadavg", "stat", "meminfo", "vmstat", "uptime", "zoneinfo", "buddyinfo", "interrupts"),
        *("softirqs", "schedstat", "diskstats", "pressure", "swaps", "sys/fs"),
    )
)
"""Paths of /proc that are empty in a jail; with those of `_hidden` they replace the engine's own list, and
include it."""

_SHOWN: Final = ("devices/system/cpu", "fs/cgroup")
"""The parts of /sys that a jail sees: the list of processors, and its own control group."""

_PROCESSOR: Final = re.compile(r"cpu(\d+|freq|idle)")
"""Folders in `devices/system/cpu` that show how busy and how fast each processor is."""

_ULIMITS: Final = {"msgqueue": 0, "core": 0, "sigpending": 256, "nofile": 1024}
"""Limits of what a process could use of the kernel's memory, by their names in Docker's API."""

_USERS: Final = range(40_000, 60_000)
"""Users of jails: within the 65,536 of a rootless engine, and above those of most machines."""

_GIANT: Final = 8 * 2**30
"""Size in bytes from which an image is worth a warning."""

_NEEDED: Final = {"MemoryLimit": "memory", "PidsLimit": "processes", "CpuCfsQuota": "processors"}
"""Limits that an engine must support: their keys in its description, and their names in messages."""


def jail(limits: Limits, launch: Launch, user: str, podman: bool = False) -> dict[str, Any]:
    """Return the settings of a container that is a jail, in the form of Docker's API.

    Args:
        limits: limits of the entrant.
        launch: directory and session of the entrant's hub.
        user: user and group, see `own_user`.
        podman: whether the engine is podman, which takes the path of a seccomp profile instead of its text.
    """
    seccomp = str(_SECCOMP) if podman else _SECCOMP.read_text(encoding="utf-8")
    return {
        "Env": [f"{name}={value}" for name, value in variables(_HUB, launch.session).items()],
        "User": user,
        "Healthcheck": {"Test": ["NONE"]},  # the engine runs nothing on behalf of the image
        "Labels": {LABEL: launch.run},
        "HostConfig": {
            "NetworkMode": "none",
            "Mounts": [{"Type": "bind", "Source": str(launch.folder), "Target": _FOLDER, "ReadOnly": True}],
            "Init": True,
            "ReadonlyRootfs": True,
            "Tmpfs": {"/tmp": f"size={limits.tmp},mode=1777,nosuid,nodev,noexec"},
            "CapDrop": ["ALL"],
            "SecurityOpt": ["no-new-privileges", f"seccomp={seccomp}"],
            "MaskedPaths": [*_MASKED, *_hidden(Path("/sys"), _SHOWN)],
            "Ulimits": [{"Name": name, "Soft": most, "Hard": most} for name, most in _ULIMITS.items()],
            "PidsLimit": limits.pids,
            "Memory": limits.memory,
            "MemorySwap": limits.memory,
            "NanoCpus": round(limits.cpus * 1e9),
            "ShmSize": limits.shm,
            "LogConfig": {"Type": "none", "Config": {}},  # the organiser reads the output, up to `Limits.log`
        },
    }


def check_engine(found: Mapping[str, Any], address: str) -> None:
    """Check that an engine can hold a jail.

    Args:
        found: the engine's description of itself.
        address: address of the engine, for the message.

    Raises:
        ConfigError: it cannot limit the resources of an entrant.
    """
    lacking = [what for key, what in _NEEDED.items() if not found.get(key)]
    if lacking:
        raise ConfigError(
            f"the container engine at {address} cannot limit {', '.join(lacking)}, and an entrant could take "
            "all of this machine's; with a rootless engine, delegate these cgroup controllers to its user"
        )


def check_image(image: str, settings: Mapping[str, Any], size: int) -> str | None:
    """Check that an image can be jailed; return a warning, if there is one.

    Args:
        image: its name.
        settings: its configuration.
        size: its size in bytes.

    Raises:
        ConfigError: it has nothing to run, or declares volumes, which the engine would keep on this machine's
            disk, without limit.
    """
    if not settings.get("Cmd") and not settings.get("Entrypoint"):
        raise ConfigError(f"the image {image} has nothing to run: add CMD to its Dockerfile")
    if settings.get("Volumes"):
        volumes = one_line(", ".join(settings["Volumes"]), 80)
        raise ConfigError(
            f"the image {image} declares a volume, {volumes}, in which it could fill "
            "this machine's disk: remove VOLUME from its Dockerfile; a jail can write to /tmp"
        )
    if size > _GIANT:
        return f"the image {image} takes {size / 2**30:.1f} GiB of this machine's disk"
    return None


def check_limits(limits: Limits, processors: int) -> None:
    """Check that a machine has what its entrants are promised.

    Raises:
        ConfigError: it has fewer processors.
    """
    if limits.cpus > processors:
        raise ConfigError(f"[limits] has cpus = {limits.cpus:g}, but this machine has only {processors}")


@contextmanager
def own_user() -> Iterator[str]:
    """Yield a user and group that no other jail on this machine has at the same time.

    The kernel counts much by user: with one user for all, entrants could take each other's share of it, and
    signal to each other by what is left. The socket of the number's name is gone when its process is.
    """
    with socket.socket(socket.AF_UNIX) as taken:
        for number in _USERS:
            with suppress(OSError):
                taken.bind(f"\0glue-jail-{number}")
                break
        else:
            raise ExperimentError(f"all {len(_USERS)} users for containers are taken")
        yield f"{number}:{number}"


def _hidden(folder: Path, shown: Sequence[str]) -> Iterator[str]:
    """Yield the paths in a folder of /sys that a jail does not see."""
    for path in sorted(folder.iterdir()):
        within = [name.partition("/")[2] for name in shown if name.split("/")[0] == path.name]
        if not within:
            yield str(path)
        elif "" not in within:
            yield from _hidden(path, within)
        else:
            yield from (str(one) for one in sorted(path.iterdir()) if _PROCESSOR.fullmatch(one.name))
