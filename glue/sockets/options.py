"""What a hub and its peers set on their sockets alike: each side notices when the other's host is gone."""

from __future__ import annotations

import socket
from typing import Final

__all__ = ["limit_silence", "probe_when_silent", "unix_address"]

_PROBES: Final = 3
"""Unanswered probes after which a silent host is considered gone."""

_MAX_SILENCE: Final = 32_767
"""Seconds; Linux, MAX_TCP_KEEPIDLE."""


def unix_address(path: str) -> str:
    """Return the address of a Unix socket; a `path` that begins with `@` is Linux's abstract kind."""
    return "\0" + path[1:] if path.startswith("@") else path


def probe_when_silent(connected: socket.socket, seconds: float) -> None:
    """Have the system probe a host that has been silent for so many seconds, and give it up after three."""
    if connected.family == socket.AF_UNIX:
        return
    connected.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    interval = min(max(1, round(seconds)), _MAX_SILENCE)
    for name, value in (("TCP_KEEPIDLE", interval), ("TCP_KEEPINTVL", interval), ("TCP_KEEPCNT", _PROBES)):
        if hasattr(socket, name):  # not everywhere
            connected.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


def limit_silence(connected: socket.socket, seconds: float) -> None:
    """Consider the other side gone when what was sent to it stays unacknowledged for so many seconds."""
    if connected.family != socket.AF_UNIX and hasattr(socket, "TCP_USER_TIMEOUT"):  # not everywhere
        connected.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, max(1, int(seconds * 1000)))
