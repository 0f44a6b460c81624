"""Serving the page with uvicorn, until Ctrl-C, despite connections that never show the token.

Any user of this machine can connect, and without limits could hold every descriptor of the server. A
connection is admitted by its first request with the cookie. Until then it has a few seconds, and is dropped
for a newer one if there are too many, so a browser gets in however many idle connections there are.
"""

from __future__ import annotations

import asyncio
import logging
import os
import resource
import secrets
import socket
import sys
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Final

import uvicorn
from starlette.types import ASGIApp
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.server import Server

from experiment_runner.view.guard import ADMIT, Address
from experiment_runner.view.stream import Pulse
from glue.errors import ConfigError

DEFAULT_PORT: Final = 8097
_TOKEN_BYTES: Final = 24
_BACKLOG: Final = 128
_FAREWELL_SECONDS: Final = 0.5
_SPARE: Final = 200
"""Descriptors for everything that is not a connection: stores, recordings, observers."""


@dataclass(frozen=True, slots=True)
class Place:
    """Where a page is served.

    Args:
        host: an IP address or a name of this machine.
        port: to listen at, 0 for any that is free, None for `DEFAULT_PORT` or, if that is taken, any.
        proxy: the address at which browsers find the page, such as `https://lab.example/runs`; may be empty.
    """

    host: str
    port: int | None
    proxy: str = ""


def new_token() -> str:
    """Return a new secret that opens a page."""
    return secrets.token_urlsafe(_TOKEN_BYTES)


def serve(
    app: Callable[[Address, Pulse], ASGIApp],
    place: Place,
    ready: Callable[[str], None],
    http: type[Connection] | None = None,
) -> None:
    """Serve a page until SIGINT or SIGTERM, whose handlers are called at the end.

    Args:
        app: returns the guarded application for the names by which it may be addressed.
        place: where.
        ready: called with the page's address when requests are accepted.
        http: the limits of connections, by default `Connection`.

    Raises:
        ConfigError: the server cannot listen there.
    """
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))
    with listen(place) as listening:
        port = int(listening.getsockname()[1])
        address = Address(port, place.proxy, open_to_all=not is_loopback(place.host))
        pulse = Pulse()
        config = uvicorn.Config(
            app(address, pulse),
            access_log=False,  # the log would hold the token
            http=http or Connection,
            lifespan="off",
            log_config=None,
            log_level=logging.CRITICAL,
            proxy_headers=False,
            server_header=False,
            timeout_graceful_shutdown=_FAREWELL_SECONDS,
            ws="none",
        )
        server = _Server(config, pulse, lambda: ready(_url(place, port)))
        asyncio.run(server.serve([listening]))


class _Server(Server):
    """A server that says when it is ready, and ends its streams before it ends."""

    def __init__(self, config: uvicorn.Config, pulse: Pulse, ready: Callable[[], None]) -> None:
        super().__init__(config)
        self._pulse = pulse
        self._ready = ready

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        self._ready()

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        self._pulse.close()
        await super().shutdown(sockets)


def is_loopback(host: str) -> bool:
    """Return whether only this machine can reach an address."""
    try:
        found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    except OSError:
        return False
    return all(address[4][0] in ("127.0.0.1", "::1") for address in found)


class Connection(H11Protocol):
    """A connection that uvicorn serves, with limits.

    Attributes:
        most: maximum number of connections; fewer if the limit of open files is low.
        share: maximum number of connections from one address that are not yet admitted.
        head_seconds: maximum time from the beginning of a connection until it is admitted.
    """

    most: ClassVar[int] = 1000
    share: ClassVar[int] = 250
    head_seconds: ClassVar[float] = 10.0

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self.app_state: dict[str, Any] = {**self.app_state, ADMIT: self._admit}
        self._address = ""
        self._timer: asyncio.TimerHandle | None = self.loop.call_later(self.head_seconds, self._drop)

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Make room for the connection, or close it if all others are admitted."""
        peer = transport.get_extra_info("peername")
        self._address = str(peer[0]) if peer else ""
        waiting = [other for other in self.connections if isinstance(other, Connection) and other._timer]
        same = [other for other in waiting if other._address == self._address]
        full = len(self.connections) >= min(self.most, _room())
        super().connection_made(transport)
        if len(same) >= self.share or full:
            oldest = min(same if len(same) >= self.share else waiting, key=_begun, default=self)
            oldest._drop()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self._admit()
        super().connection_lost(exc)

    def _admit(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _drop(self) -> None:
        self._admit()
        self.connections.discard(self)
        self.transport.abort()


def _begun(connection: Connection) -> float:
    assert connection._timer is not None
    return connection._timer.when()


def _room() -> int:
    """Return the number of descriptors that this process has for connections."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return sys.maxsize if soft == resource.RLIM_INFINITY else max(soft // 2, soft - _SPARE)


def listen(place: Place) -> socket.socket:
    """Return a socket that listens at a place.

    Raises:
        ConfigError: the server cannot listen there.
    """
    host, port = place.host, place.port
    for number in (DEFAULT_PORT, 0) if port is None else (port,):
        try:
            family, *_, address = socket.getaddrinfo(host, number, type=socket.SOCK_STREAM)[0]
            both = family is socket.AF_INET6 and socket.has_dualstack_ipv6()
            return socket.create_server(address, family=family, backlog=_BACKLOG, dualstack_ipv6=both)
        except socket.gaierror as error:
            raise ConfigError(f"cannot listen at {host}: {error.strerror}") from error
        except OSError as error:
            failure = error
    # create_server adds the address to the reason
    raise ConfigError(
        f"cannot listen at {host}, port {number}: {os.strerror(failure.errno or 0)}: choose another port",
        settings=("port", "page"),
    ) from failure


def _url(place: Place, port: int) -> str:
    if place.proxy:
        return f"{place.proxy.rstrip('/')}/"
    host = socket.gethostname() if place.host in ("0.0.0.0", "::") else place.host
    return f"http://{f'[{host}]' if ':' in host else host}:{port}/"
