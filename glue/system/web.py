"""One request over HTTP to a server that is not trusted: bounded in time and size, never redirected."""

from __future__ import annotations

import http.client
import json
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, BinaryIO, Final
from urllib.parse import urlsplit

from glue.console import one_line
from glue.errors import GlueError, described
from glue.system import network
from glue.system.threads import Event, Timer

MOST_BYTES: Final = 2**20
"""Maximum size of an answer."""

_MOST_SHOWN: Final = 200
_KINDS: Final = {"http": http.client.HTTPConnection, "https": http.client.HTTPSConnection}


class NoAnswer(GlueError):
    """No answer has come; the message completes the server's address, as "cannot be asked: ..." does."""


@dataclass(frozen=True, slots=True)
class Answer:
    """The answer of a server.

    Args:
        status: of HTTP.
        headers: by their names, in any case.
        data: the body.
    """

    status: int
    headers: Mapping[str, str]
    data: bytes

    @property
    def json(self) -> Any:
        """The body as JSON; None if it is not."""
        with suppress(ValueError, RecursionError):
            return json.loads(self.data)
        return None


def is_address(url: str) -> bool:
    """Return whether `ask` accepts an address: of HTTP, without a password or parameters."""
    try:
        parts = urlsplit(url)
        secrets = any((parts.username, parts.password, parts.query, parts.fragment))
        found = parts.scheme in _KINDS and parts.hostname and parts.port != 0 and not secrets
    except ValueError:
        return False
    return bool(found) and url.isascii() and url.isprintable() and " " not in url


def ask(
    method: str,
    url: str,
    seconds: float,
    body: bytes | BinaryIO = b"",
    headers: Mapping[str, str] | None = None,
) -> Answer:
    """Return the answer to a request.

    Args:
        method: of HTTP.
        url: address, of which `is_address` is true.
        seconds: for the whole exchange, however slowly the server reads and sends.
        body: what is sent.
        headers: of the request; with a `Content-Length` if the body is a file.

    Raises:
        NoAnswer: none has come in that time, or one of more than `MOST_BYTES`.
    """
    parts = urlsplit(url)
    connection = _KINDS[parts.scheme](parts.hostname or "", parts.port, timeout=seconds)
    sockets: list[network.socket] = []
    late = Event()

    def give_up() -> None:
        late.set()
        for each in sockets:
            with suppress(OSError):
                each.shutdown(network.SHUT_RDWR)

    timer = Timer(seconds, give_up)
    timer.daemon = True
    timer.start()
    try:
        connection.connect()
        sockets.append(connection.sock)
        if not late.is_set():
            with suppress(BrokenPipeError, ConnectionResetError):  # it refuses the body, and says why
                connection.request(
                    method, parts.path or "/", body, {**(headers or {}), "Connection": "close"}
                )
            with connection.getresponse() as response:
                data = response.read(MOST_BYTES + 1)
                if response.length and len(data) <= MOST_BYTES:  # the connection broke
                    raise http.client.IncompleteRead(data, response.length)
        if late.is_set():
            raise TimeoutError
    except (OSError, ValueError, http.client.HTTPException) as error:
        if late.is_set() or isinstance(error, TimeoutError):
            raise NoAnswer(f"has not answered within {seconds:g} s") from None
        why = error.strerror if isinstance(error, OSError) else None
        raise NoAnswer(f"cannot be asked: {one_line(why or described(error), _MOST_SHOWN)}") from None
    finally:
        timer.cancel()
        connection.close()
    if len(data) > MOST_BYTES:
        raise NoAnswer(f"has sent more than {MOST_BYTES:,} bytes")
    return Answer(response.status, response.headers, data)
