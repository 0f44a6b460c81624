"""Listening addresses, and the connections accepted from them in the hub's loop.

A hub opens its addresses itself. A program that runs several hubs one after the other, or that wants to know
early whether an address is free, opens it once and hands it to each hub:

    with open_address("tcp://127.0.0.1:4097") as public:
        for trial in trials:
            with Hub(config, opened={public.url: public}).in_background():
                ...

Between two hubs the operating system keeps accepting connections; the next hub serves them.
"""

from __future__ import annotations

import errno
import os
import stat
import traceback
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from typing import Any, Final

from glue.closing import Closing
from glue.errors import ConfigError
from glue.hub.io.loop import READ, Loop
from glue.system import network
from glue.system.sockets import unix_address

Accept = Callable[[network.socket, str, float], None]
"""A function of a connection, the peer's address for people, and the time."""

_BACKLOG: Final = 1024
"""Maximum number of connections that wait to be accepted; Java programs try hundreds of times a second."""


class OpenAddress(Closing):
    """A socket that listens until it is closed.

    Attributes:
        url: the address as it was given.
        endpoint: the address, with a free port resolved.
        socket: the socket, which does not block.
    """

    def __init__(self, url: str, listening: network.socket) -> None:
        listening.setblocking(False)
        self.url = url
        self.socket = listening
        name = listening.getsockname()
        if listening.family == network.AF_UNIX:
            self.endpoint: str = url
        else:
            host = f"[{name[0]}]" if ":" in name[0] else name[0]
            self.endpoint = f"tcp://{host}:{name[1]}"

    @property
    def port(self) -> int:
        """The TCP port."""
        return int(self.socket.getsockname()[1])

    def close(self) -> None:
        """Stop listening, and remove the path of a Unix socket."""
        path = self.socket.getsockname() if self.socket.family == network.AF_UNIX else b""
        self.socket.close()
        # If the path was removed meanwhile, another hub may listen there by now.
        if isinstance(path, str) and is_left_over(path):
            with suppress(OSError):
                os.unlink(path)


def open_address(url: str, setting: str = "bind", *, reserved: bool = False) -> OpenAddress:
    """Listen on an address of `glue.hub.config.check_url`; the port `*` takes any free one.

    Names and the host `*` resolve to IPv4 addresses only: peers and original programs look for no others.

    Args:
        url: the address.
        setting: name of the setting that holds the address, for the error.
        reserved: whether it may be one that `reserve` keeps.

    Raises:
        ConfigError: the address is in use, or is not one of this machine.
    """
    scheme, _, rest = url.partition("://")
    try:
        listening = _listen_on_path(rest) if scheme == "ipc" else _listen_on_port(rest, reserved)
    except OSError as error:
        raise ConfigError(_cannot_listen(url, error), settings=(setting,)) from None
    return OpenAddress(url, listening)


@contextmanager
def reserve(url: str) -> Iterator[None]:
    """Keep a port, within a `with` statement, for processes of this user that open it as reserved.

    Raises:
        ConfigError: the address is in use, or is not one of this machine.
    """
    scheme, _, rest = url.partition("://")
    with ExitStack() as stack:
        if scheme == "tcp" and not rest.endswith(":*"):
            try:
                family, address = _resolved(rest)
                with network.socket(family) as alone:  # what another process of this user reserves is in use
                    alone.setsockopt(network.SOL_SOCKET, network.SO_REUSEADDR, 1)
                    alone.bind(address)
                kept = stack.enter_context(network.socket(family))
                # Without SO_REUSEADDR, and not listening: then only sockets of this user can share the port.
                kept.setsockopt(network.SOL_SOCKET, network.SO_REUSEPORT, 1)
                kept.bind(address)
            except OSError as error:
                raise ConfigError(_cannot_listen(url, error), settings=("bind",)) from None
        yield


class Listener:
    """Accepts the connections of an open address, from the moment it is made until `stop`.

    Args:
        loop: the loop it runs in, not yet running.
        address: the open address of the connections; closed by the caller.
        accept: takes each connection. It may raise OSError if the connection has already gone.
        log: takes a line for people when connections cannot be accepted.
    """

    def __init__(self, loop: Loop, address: OpenAddress, accept: Accept, log: Callable[[str], None]) -> None:
        self._loop = loop
        self._socket = address.socket
        self._accept = accept
        self._log = log
        self._queued = False
        self._stopped = False
        self._watch(0.0)
        # Watch again after a lack of descriptors for a connection.
        loop.on_tick(self._watch)

    def stop(self) -> None:
        """Accept no more connections."""
        self._stopped = True
        self._loop.unwatch(self._socket.fileno())

    def _watch(self, now: float) -> None:
        if not self._queued and not self._stopped:
            self._loop.watch(self._socket.fileno(), READ, self)

    def turn(self, now: float) -> None:
        """Queue the acceptance of a waiting connection."""
        self._queued = True
        self._loop.unwatch(self._socket.fileno())
        self._loop.queue(self._take)

    def _take(self, now: float) -> None:
        self._queued = False
        if self._stopped:
            return
        try:
            connected, address = self._socket.accept()
        except BlockingIOError:
            self._watch(now)
            return
        except OSError as error:
            # The next tick tries again.
            self._log(f"cannot accept a connection for now: {error.strerror}")
            return
        self._watch(now)
        name = (
            f"{address[0]}:{address[1]}" if isinstance(address, tuple) else f"descriptor {connected.fileno()}"
        )
        try:
            self._accept(connected, name, now)
        except Exception as error:
            if not isinstance(error, OSError):  # an OSError: the connection has already gone
                report = traceback.format_exc()
                self._loop.log(f"{name} was dropped after an error of the hub; please report this:\n{report}")
            self._loop.unwatch(connected.fileno())
            connected.close()


def _listen_on_port(address: str, reserved: bool) -> network.socket:
    family, resolved = _resolved(address)
    return network.create_server(resolved, family=family, backlog=_BACKLOG, reuse_port=reserved)


def _resolved(address: str) -> tuple[int, tuple[Any, ...]]:
    """Return the family and the address of `HOST:PORT`."""
    host, _, port = address.rpartition(":")
    host = host.strip("[]")
    family = network.AF_INET6 if ":" in host else network.AF_INET
    _, _, _, _, resolved = network.getaddrinfo(
        None if host == "*" else host,
        0 if port == "*" else int(port),
        family,
        network.SOCK_STREAM,
        flags=network.AI_PASSIVE,
    )[0]
    return family, resolved[:2]


def _listen_on_path(path: str) -> network.socket:
    """Return a Unix socket that listens on `path`; replace a socket on which no process listens any more.

    Raises:
        OSError: `path` cannot be listened on.
    """
    address = unix_address(path)
    listening = network.socket(network.AF_UNIX)
    try:
        if address == path and is_left_over(path):
            os.unlink(path)
        listening.bind(address)
        listening.listen(_BACKLOG)
    except OSError:
        listening.close()
        raise
    return listening


def is_left_over(path: str) -> bool:
    """Return whether `path` is a Unix socket on which no process listens any more."""
    try:
        if not stat.S_ISSOCK(os.stat(path).st_mode):
            return False
    except OSError:
        return False
    with network.socket(network.AF_UNIX) as probe:
        probe.setblocking(False)  # the process that listens there may be too busy to accept
        return probe.connect_ex(path) == errno.ECONNREFUSED


def _cannot_listen(url: str, error: OSError) -> str:
    if error.errno == errno.EADDRINUSE:
        return (
            f"{url} is in use: is another hub, experiment or rl_glue server running there? "
            "Stop it, or choose another address"
        )
    if error.errno == errno.EADDRNOTAVAIL or isinstance(error, network.gaierror):
        return f"{url} is not an address of this machine"
    return f"cannot listen on {url}: {os.strerror(error.errno or 0)}"
