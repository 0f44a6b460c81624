"""Socket options of hubs and peers, by which each side notices when the other's host is gone."""

from __future__ import annotations

import struct
from typing import Final

from glue.system import network

_PROBES: Final = 3
"""Unanswered probes after which a silent host is considered gone."""

_MAX_SILENCE: Final = 32_767
"""Maximum silence in seconds; Linux, MAX_TCP_KEEPIDLE."""

_RESET: Final = struct.pack("ii", 1, 0)
"""Value of SO_LINGER: unsent data is dropped, and the other side sees a reset."""


def unix_address(path: str) -> str:
    """Return the address of a Unix socket; a `path` that begins with `@` is an abstract address of Linux."""
    return "\0" + path[1:] if path.startswith("@") else path


def never_wait(connected: network.socket) -> None:
    """Have no call of a socket block, and no small message wait for others."""
    connected.setblocking(False)
    if connected.family != network.AF_UNIX:
        connected.setsockopt(network.IPPROTO_TCP, network.TCP_NODELAY, 1)


def reset_when_closed(connected: network.socket) -> None:
    """Have the next system call of the other side fail once the socket is closed."""
    connected.setsockopt(network.SOL_SOCKET, network.SO_LINGER, _RESET)


def wait_for(waiting: network.socket, events: int, seconds: float) -> bool:
    """Return whether one of these events of a socket occurs within `seconds`."""
    poller = network.poll()
    poller.register(waiting, events)
    return bool(poller.poll(max(0.0, seconds) * 1000))


def probe_when_silent(connected: network.socket, seconds: float) -> None:
    """Have the kernel probe a host that is silent for `seconds`, and give it up after three failed probes."""
    if connected.family == network.AF_UNIX:
        return
    connected.setsockopt(network.SOL_SOCKET, network.SO_KEEPALIVE, 1)
    interval = min(max(1, round(seconds)), _MAX_SILENCE)
    for name, value in (("TCP_KEEPIDLE", interval), ("TCP_KEEPINTVL", interval), ("TCP_KEEPCNT", _PROBES)):
        option = network.tcp_option(name)
        if option is not None:
            connected.setsockopt(network.IPPROTO_TCP, option, value)


def limit_silence(connected: network.socket, seconds: float) -> None:
    """Consider the other side gone when data sent to it stays unacknowledged for `seconds`."""
    option = network.tcp_option("TCP_USER_TIMEOUT")
    if connected.family != network.AF_UNIX and option is not None:
        connected.setsockopt(network.IPPROTO_TCP, option, max(1, int(seconds * 1000)))
