"""What a jail is: how a container engine is to run an image that nobody has reviewed.

A jail has no network. It has one way out: the directory with the hub's socket, mounted read-only. Its file
system is read-only too, except for a small /tmp in memory, and what its processes use is limited. They have
no privileges and cannot gain any. docs/security.md says which attack each of this is for.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Final

from experiment_runner.competition.settings import Limits
from experiment_runner.competition.starting import SOCKET, Place, variables
from glue.errors import ConfigError

__all__ = ["LABEL", "check_engine", "check_image", "jail", "user_of"]

LABEL: Final = "glue.competition"
"""Label of our containers: the run that they belong to."""

_FOLDER: Final = "/run/glue"
"""Where the directory with the hub's socket is mounted."""

_NOBODY: Final = "65534:65534"

_NUMBERS: Final = re.compile(r"([1-9]\d{0,8})(?::(\d{1,9}))?")

_NEEDED: Final = {"MemoryLimit": "memory", "PidsLimit": "processes", "CpuCfsQuota": "processors"}
"""What an engine says that it can limit, and what that is to people."""


def jail(limits: Limits, place: Place, user: str) -> dict[str, Any]:
    """Return how the engine is to make a jail, in the words of Docker's SDK.

    Args:
        limits: what the entrant may use.
        place: where it meets the hub.
        user: of `user_of`.
    """
    return {
        "environment": dict(variables(f"ipc://{_FOLDER}/{SOCKET}", place.session)),
        "network_mode": "none",
        "volumes": {str(place.folder): {"bind": _FOLDER, "mode": "ro"}},
        "init": True,
        "user": user,
        "read_only": True,
        "tmpfs": {"/tmp": f"size={limits.tmp},mode=1777,nosuid,nodev,noexec"},
        "cap_drop": ["ALL"],
        "security_opt": ["no-new-privileges"],  # and the engine's default for seccomp
        "pids_limit": limits.pids,
        "mem_limit": limits.memory,
        "memswap_limit": limits.memory,
        "nano_cpus": round(limits.cpus * 1e9),
        "shm_size": limits.shm,
        "log_config": {"Type": "none", "Config": {}},  # what it prints is read, up to `Limits.log`
        "healthcheck": {"test": ["NONE"]},  # the engine runs nothing on behalf of the image
        "labels": {LABEL: place.run},
    }


def check_engine(found: Mapping[str, Any], address: str) -> None:
    """Check that an engine can hold a jail.

    Args:
        found: what it says of itself.
        address: where it listens, for the message.

    Raises:
        ConfigError: it cannot limit what an entrant uses.
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
    """Return the user and group as whom an image is run, as numbers, and whether it declares them itself.

    A name says nothing: which number it stands for is written in the image.

    Args:
        declared: `USER` of the image; empty for root.
    """
    match = _NUMBERS.fullmatch(declared)
    if match is None:
        return _NOBODY, False
    return f"{match[1]}:{match[2] or match[1]}", True
