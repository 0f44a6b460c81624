"""Where connections come in: a port or a path that is listened on, in the hub's loop."""

from __future__ import annotations

import errno
import os
import socket
import stat
from collections.abc import Callable
from contextlib import suppress
from typing import Final

from glue.hub.loop import FAILURE, READ, Loop

__all__ = ["Accept", "Listener", "listen_on_path", "listen_on_port"]

Accept = Callable[[socket.socket, str, float], None]
"""Takes a connection, the other side's address for people, and the time."""

_BACKLOG: Final = 1024
"""Connections that the system takes in before we do; Java programs try hundreds of times a second."""

_BATCH: Final = 64
"""Connections of one port that are accepted before the others get their turn."""


class Listener:
    """Accepts connections, from the moment it is made until it is closed.

    Args:
        loop: where it waits; one that does not run yet.
        listening: the socket; it is closed by `close`.
        accept: takes each connection. It may raise OSError: the connection is gone again.
        log: takes a line for people when connections cannot be accepted.
    """

    def __init__(
        self, loop: Loop, listening: socket.socket, accept: Accept, log: Callable[[str], None]
    ) -> None:
        listening.setblocking(False)
        self._loop = loop
        self._socket = listening
        self._accept = accept
        self._log = log
        self._listen(0.0)
        # Again, if it was given up for want of descriptors.
        loop.on_tick(self._listen)

    def close(self) -> None:
        """Stop listening."""
        self._loop.unwatch(self._socket.fileno())
        path = self._socket.getsockname() if self._socket.family == socket.AF_UNIX else b""
        self._socket.close()
        # If it was removed meanwhile, another hub may listen there by now.
        if isinstance(path, str) and _is_left_over(path):
            with suppress(OSError):
                os.unlink(path)

    def _listen(self, now: float) -> None:
        self._loop.watch(self._socket.fileno(), READ, self._take_in)

    def _take_in(self, now: float) -> None:
        for _ in range(_BATCH):
            try:
                connected, address = self._socket.accept()
            except BlockingIOError:
                return
            except OSError as error:
                self._log(f"cannot accept a connection for now: {error.strerror}")
                self._loop.watch(self._socket.fileno(), FAILURE, self._take_in)
                return
            name = (
                f"{address[0]}:{address[1]}"
                if isinstance(address, tuple)
                else f"descriptor {connected.fileno()}"
            )
            try:
                self._accept(connected, name, now)
            except OSError:
                # Gone already.
                connected.close()


def listen_on_port(host: str, port: int) -> socket.socket:
    """Return a socket that listens on a TCP port; 0 takes any free one, and `*` stands for every address.

    Of a name, and of `*`, the addresses are those of IPv4: peers and original programs look for no others.

    Raises:
        OSError: it cannot.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    _, _, _, _, address = socket.getaddrinfo(
        None if host == "*" else host, port, family, socket.SOCK_STREAM, flags=socket.AI_PASSIVE
    )[0]
    return socket.create_server(address[:2], family=family, backlog=_BACKLOG)


def listen_on_path(path: str) -> socket.socket:
    """Return a Unix socket that listens on `path`; one that nobody listens on any more is replaced.

    A path that begins with `@` is Linux's abstract kind.

    Raises:
        OSError: it cannot.
    """
    address = "\0" + path[1:] if path.startswith("@") else path
    listening = socket.socket(socket.AF_UNIX)
    try:
        if address is path and _is_left_over(path):
            os.unlink(path)
        listening.bind(address)
        listening.listen(_BACKLOG)
    except OSError:
        listening.close()
        raise
    return listening


def _is_left_over(path: str) -> bool:
    try:
        if not stat.S_ISSOCK(os.stat(path).st_mode):
            return False
    except OSError:
        return False
    with socket.socket(socket.AF_UNIX) as probe:
        probe.setblocking(False)  # whoever listens there may be too busy to take us in
        return probe.connect_ex(path) == errno.ECONNREFUSED
