"""The jail of an entrant: the settings with which a container engine runs an unreviewed image.

A jail has no network. Its only way out is the directory with the hub's socket, mounted read-only. Its file
system is read-only too, except for a small /tmp in memory, and memory, processors and processes are limited.
Its programs have no privileges and cannot gain any, and can make only the system calls of `seccomp.json`.
docs/security.md names the attack that each setting prevents.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from experiment_runner.competition.settings import Limits
from experiment_runner.competition.starting import SOCKET, Launch, variables
from glue.errors import ConfigError

LABEL: Final = "glue.competition"
"""Label of our containers: the run that they belong to."""

_FOLDER: Final = "/run/glue"
"""Mount point of the directory with the hub's socket."""

_HUB: Final = f"ipc://{_FOLDER}/{SOCKET}"

_NOBODY: Final = "65534:65534"

_NUMBERS: Final = re.compile(r"([1-9]\d{0,8})(?::(\d{1,9}))?")

_SECCOMP: Final = Path(__file__).with_name("seccomp.json")
"""The system calls of a jail, in Docker's format. Not among them are `AF_VSOCK`, `io_uring` and others that
the default of Docker 20.10 allows."""

_MASKED: Final = (
    *(
        f"/proc/{name}"
        for name in ("acpi", "asound", "kcore", "keys", "latency_stats", "sched_debug", "scsi")
    ),
    *(f"/proc/{name}" for name in ("timer_list", "timer_stats", "kallsyms", "kpagecount", "kpageflags")),
    "/sys/firmware",
    "/sys/devices/virtual/powercap",
    # The load of the whole machine, through which entrants could watch and signal each other.
    *(
        f"/proc/{name}"
        for name in ("loadavg", "stat", "meminfo", "vmstat", "uptime", "zoneinfo", "buddyinfo")
    ),
    *(f"/proc/{name}" for name in ("interrupts", "softirqs", "schedstat", "diskstats", "pressure", "swaps")),
)
"""Paths that are empty in a jail; this list replaces the engine's own, and includes it."""

_NEEDED: Final = {"MemoryLimit": "memory", "PidsLimit": "processes", "CpuCfsQuota": "processors"}
"""Limits that an engine must support: their keys in its description, and their names in messages."""


def jail(limits: Limits, launch: Launch, user: str, podman: bool = False) -> dict[str, Any]:
    """Return the settings of a container that is a jail, in the form of Docker's API.

    Args:
        limits: limits of the entrant.
        launch: directory and session of the entrant's hub.
        user: user and group, see `user_of`.
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
            "MaskedPaths": list(_MASKED),
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


def check_image(image: str, settings: Mapping[str, Any]) -> str | None:
    """Check that an image can be jailed; return a warning, if there is one.

    Args:
        image: its name.
        settings: its configuration.

    Raises:
        ConfigError: it has nothing to run, or declares volumes, which the engine would keep on this machine's
            disk, without limit.
    """
    if not settings.get("Cmd") and not settings.get("Entrypoint"):
        raise ConfigError(f"the image {image} has nothing to run: add CMD to its Dockerfile")
    if settings.get("Volumes"):
        raise ConfigError(
            f"the image {image} declares a volume, {', '.join(settings['Volumes'])}, in which it could fill "
            "this machine's disk: remove VOLUME from its Dockerfile; a jail can write to /tmp"
        )
    declared = settings.get("User") or ""
    user, chosen = user_of(declared)
    if chosen:
        return None
    return (
        f"the image {image} is to run as {declared or 'root'}, which need not be an unprivileged user: it is "
        f"run as {user}, and can read what everybody may; better is a number in its Dockerfile: USER 1000"
    )


def user_of(declared: str) -> tuple[str, bool]:
    """Return the numeric user and group that an image runs as, and whether the image declares them itself.

    A name is not enough: the image itself defines the number of that name.

    Args:
        declared: `USER` of the image; empty for root.
    """
    match = _NUMBERS.fullmatch(declared)
    if match is None:
        return _NOBODY, False
    return f"{match[1]}:{match[2] or match[1]}", True
