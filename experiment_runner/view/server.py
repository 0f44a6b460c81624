"""Serving the page with uvicorn, until Ctrl-C."""

from __future__ import annotations

import asyncio
import logging
import secrets
import socket
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Final

import uvicorn

from experiment_runner.view.app import page
from experiment_runner.view.connections import Connection, raise_descriptors
from experiment_runner.view.guard import Address
from experiment_runner.view.stream import Pulse
from glue.errors import ConfigError

DEFAULT_PORT: Final = 8097
_TOKEN_BYTES: Final = 24
_BACKLOG: Final = 128
_LOOK_SECONDS: Final = 0.05
_FAREWELL_SECONDS: Final = 0.5


def serve(
    folders: Sequence[Path],
    port: int | None,
    host: str,
    proxy: str,
    ready: Callable[[str], None],
) -> None:
    """Serve the page until SIGINT or SIGTERM, whose handlers are called at the end.

    Args:
        folders: runs and folders of runs that it shows.
        port: to listen at, 0 for any that is free, None for `DEFAULT_PORT` or, if that is taken, any.
        host: an IP address or a name of this machine.
        proxy: the address at which browsers find the page, if that differs.
        ready: called with the address to open, token included, when requests are accepted.

    Raises:
        ConfigError: the server cannot listen there.
    """
    raise_descriptors()
    listening = _listen(host, port)
    with listening:
        port = int(listening.getsockname()[1])
        token = secrets.token_urlsafe(_TOKEN_BYTES)
        address = Address(port, proxy, open_to_all=not is_loopback(host))
        asyncio.run(_serve(listening, folders, address, token, ready, _url(host, port, proxy, token)))


def is_loopback(host: str) -> bool:
    """Return whether only this machine can reach an address."""
    try:
        found = socket.getaddrinfo(host, None, type=socket.SOCK_STREAM)
    except OSError:
        return False
    return all(address[4][0] in ("127.0.0.1", "::1") for address in found)


async def _serve(
    listening: socket.socket,
    folders: Sequence[Path],
    address: Address,
    token: str,
    ready: Callable[[str], None],
    url: str,
) -> None:
    pulse = Pulse()
    server = uvicorn.Server(
        uvicorn.Config(
            page(folders, address, token, pulse),
            access_log=False,  # the log would hold the token
            http=Connection,
            lifespan="off",
            log_config=None,
            log_level=logging.CRITICAL,
            proxy_headers=False,
            server_header=False,
            timeout_graceful_shutdown=_FAREWELL_SECONDS,
            ws="none",
        )
    )
    serving = asyncio.create_task(server.serve([listening]))
    told = False
    while not serving.done() and not server.should_exit:
        if server.started and not told:
            told = True
            ready(url)
        await asyncio.wait([serving], timeout=_LOOK_SECONDS)
    pulse.close()
    await serving


def _listen(host: str, port: int | None) -> socket.socket:
    wanted = (DEFAULT_PORT, 0) if port is None else (port,)
    for number in wanted:
        try:
            family, kind, protocol, _, where = socket.getaddrinfo(host, number, type=socket.SOCK_STREAM)[0]
            listening = socket.socket(family, kind, protocol)
        except OSError as error:
            raise ConfigError(f"cannot listen at {host}: {error.strerror}") from error
        try:
            listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listening.bind(where)
            listening.listen(_BACKLOG)
        except OSError as error:
            listening.close()
            if number == wanted[-1]:
                raise ConfigError(
                    f"cannot listen at {host}, port {number}: {error.strerror}: choose another port",
                    settings=("port",),
                ) from error
            continue
        return listening
    raise AssertionError("unreachable")


def _url(host: str, port: int, proxy: str, token: str) -> str:
    if proxy:
        return f"{proxy.rstrip('/')}/?token={token}"
    if host in ("0.0.0.0", "::"):
        host = socket.gethostname()
    return f"http://{f'[{host}]' if ':' in host else host}:{port}/?token={token}"
