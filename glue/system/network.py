"""Sockets, name resolution, and waiting for descriptors: names and meanings are the standard library's."""

from __future__ import annotations

import math
import select as _select
import socket as _socket
from select import POLLIN, POLLOUT, poll, select
from socket import (
    AF_INET,
    AF_INET6,
    AI_PASSIVE,
    IPPROTO_TCP,
    SHUT_RDWR,
    SHUT_WR,
    SO_ERROR,
    SO_KEEPALIVE,
    SO_LINGER,
    SO_REUSEADDR,
    SOCK_STREAM,
    SOL_SOCKET,
    TCP_NODELAY,
    create_server,
    gaierror,
    getaddrinfo,
    socket,
    socketpair,
)
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable

__all__ = [
    "AF_INET",
    "AF_INET6",
    "AF_UNIX",
    "AI_PASSIVE",
    "IPPROTO_TCP",
    "POLLIN",
    "POLLOUT",
    "SHUT_RDWR",
    "SHUT_WR",
    "SOCK_STREAM",
    "SOL_SOCKET",
    "SO_ERROR",
    "SO_KEEPALIVE",
    "SO_LINGER",
    "SO_REUSEADDR",
    "SO_REUSEPORT",
    "TCP_NODELAY",
    "Poller",
    "PortablePoller",
    "create_server",
    "gaierror",
    "getaddrinfo",
    "poll",
    "select",
    "socket",
    "socketpair",
    "tcp_option",
]


AF_UNIX: Final[int] = getattr(_socket, "AF_UNIX", -1)
"""Address family of Unix sockets; -1, which no socket has, on systems without them."""

SO_REUSEPORT: Final[int] = getattr(_socket, "SO_REUSEPORT", -1)
"""Option by which sockets of one user share a port; -1 on systems without it."""


class PortablePoller:
    """`select.poll` in the form of `select.epoll`, for systems without the latter."""

    def __init__(self) -> None:
        self._poller = poll()
        self.register: Callable[[int, int], None] = self._poller.register
        self.modify: Callable[[int, int], None] = self._poller.modify
        self.unregister: Callable[[int], None] = self._poller.unregister

    def poll(self, seconds: float) -> list[tuple[int, int]]:
        """Return events, waiting for them up to `seconds`."""
        return self._poller.poll(math.ceil(seconds * 1000))

    def close(self) -> None:
        """Do nothing: it has no descriptor of its own."""


Poller: Final = getattr(_select, "epoll", PortablePoller)
"""Class of objects that wait for events on many descriptors."""


def tcp_option(name: str) -> int | None:
    """Return the number of a socket option such as `TCP_USER_TIMEOUT`, or None if this system lacks it."""
    number: int | None = getattr(_socket, name, None)
    return number
