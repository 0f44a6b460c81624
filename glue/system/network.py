"""Sockets, name resolution, and waiting for descriptors: names and meanings are the standard library's."""

from __future__ import annotations

import math
import select as _select
import socket as _socket
from select import POLLIN as POLLIN
from select import POLLOUT as POLLOUT
from select import poll as poll
from select import select as select
from socket import AF_INET as AF_INET
from socket import AF_INET6 as AF_INET6
from socket import AI_PASSIVE as AI_PASSIVE
from socket import IPPROTO_TCP as IPPROTO_TCP
from socket import SHUT_RDWR as SHUT_RDWR
from socket import SHUT_WR as SHUT_WR
from socket import SO_ERROR as SO_ERROR
from socket import SO_KEEPALIVE as SO_KEEPALIVE
from socket import SO_LINGER as SO_LINGER
from socket import SO_REUSEADDR as SO_REUSEADDR
from socket import SOCK_STREAM as SOCK_STREAM
from socket import SOL_SOCKET as SOL_SOCKET
from socket import TCP_NODELAY as TCP_NODELAY
from socket import create_server as create_server
from socket import gaierror as gaierror
from socket import getaddrinfo as getaddrinfo
from socket import socket as socket
from socket import socketpair as socketpair
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable

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
