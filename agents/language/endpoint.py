"""One request to an endpoint for chats, which is not trusted: bounded in time and size, never redirected."""

from __future__ import annotations

import http.client
import json
import socket
from collections.abc import Mapping
from contextlib import suppress
from threading import Event, Timer
from typing import Any, Final
from urllib.parse import urlsplit

from glue.console import one_line
from glue.errors import ConfigError, GlueError

KEY_VARIABLE: Final = "GLUE_CHAT_KEY"
"""The environment variable of the endpoint's key, which is no option because options are recorded."""

_MOST_BYTES: Final = 2**20
_MOST_SHOWN: Final = 200  # letters of what an endpoint says
_PATH: Final = "/chat/completions"
_KINDS: Final = {"http": http.client.HTTPConnection, "https": http.client.HTTPSConnection}
_LOOPBACK: Final = ("127.0.0.1", "::1", "localhost")


class EndpointFailed(GlueError):
    """The endpoint gave no usable answer; the message says what came instead."""


class EndpointBusy(EndpointFailed):
    """The same, but another try may help."""


class Endpoint:
    """An address that answers chats in the common form.

    Args:
        url: its base, such as http://127.0.0.1:8080/v1, or the whole address.
        key: what it wants as proof of who asks; None if nothing.

    Raises:
        ConfigError: it is no such address, or the key would travel in clear text.
    """

    def __init__(self, url: str, key: str | None = None) -> None:
        try:
            parts = urlsplit(url)
            secrets = any((parts.username, parts.password, parts.query, parts.fragment))
            usable = parts.scheme in _KINDS and url.isascii() and url.isprintable() and not secrets
            self._host, self._port = parts.hostname or "", parts.port
        except ValueError:
            usable = False
        if not (usable and self._host):
            text = f"without a password or parameters, as it is recorded (a key is given by {KEY_VARIABLE})"
            raise ConfigError(
                f"url is an address such as http://127.0.0.1:8080/v1, {text}", settings=("url",)
            )
        if key is not None and parts.scheme == "http" and self._host not in _LOOPBACK:
            raise ConfigError("the key would travel in clear text: use https", settings=("url",))
        if not (key or "").isascii() or not (key or "").isprintable():
            raise ConfigError(f"{KEY_VARIABLE} is no key: it has letters that cannot be sent")
        self._url = url if url.endswith(_PATH) else f"{url.rstrip('/')}{_PATH}"
        self._kind = _KINDS[parts.scheme]
        self._headers = {"Content-Type": "application/json", "Connection": "close"}
        if key is not None:
            self._headers["Authorization"] = f"Bearer {key}"

    def post(self, body: Mapping[str, Any], seconds: float) -> Any:
        """Return the JSON that the endpoint answers.

        Args:
            body: of the request.
            seconds: for the whole exchange, however slowly the endpoint sends.

        Raises:
            EndpointFailed: there is no such answer in that time.
        """
        connection = self._kind(self._host, self._port, timeout=seconds)
        sockets: list[socket.socket] = []
        late = Event()
        timer = Timer(seconds, _shut, [late, sockets])
        timer.start()
        why = f"has not answered within {seconds:g} s"
        try:
            connection.connect()
            sockets.append(connection.sock)
            if not late.is_set():
                connection.request("POST", urlsplit(self._url).path, json.dumps(body).encode(), self._headers)
                with connection.getresponse() as response:
                    data = response.read(_MOST_BYTES + 1)
            if late.is_set():
                raise TimeoutError
        except (OSError, ValueError, http.client.HTTPException) as error:
            if not (late.is_set() or isinstance(error, TimeoutError)):
                why = f"cannot be asked: {error!r}"
            raise EndpointBusy(self._failed(why)) from None
        finally:
            timer.cancel()
            connection.close()
        if len(data) > _MOST_BYTES:
            raise EndpointFailed(self._failed(f"has sent more than {_MOST_BYTES:,} bytes"))
        status, words = response.status, data.decode("utf-8", "replace")
        if 300 <= status < 400:
            words = f"a redirection to {response.headers['Location']}, which is not followed"
        if status == 429 or status >= 500:
            raise EndpointBusy(self._failed(f"answered {status}: {words}"))
        with suppress(ValueError, RecursionError):
            if status == 200:
                return json.loads(data)
        raise EndpointFailed(self._failed(f"answered {status}, not with JSON: {words}"))

    def _failed(self, why: str) -> str:
        return f"the endpoint {self._url} {one_line(why, _MOST_SHOWN)}"


def _shut(late: Event, sockets: list[socket.socket]) -> None:
    late.set()
    for each in sockets:
        with suppress(OSError):
            each.shutdown(socket.SHUT_RDWR)
