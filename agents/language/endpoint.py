"""One request to an endpoint for chats, which is not trusted: bounded in time and size, never redirected."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any, Final
from urllib.parse import urlsplit

from glue.console import one_line
from glue.errors import ConfigError, GlueError
from glue.system.web import NoAnswer, ask, is_address

KEY_VARIABLE: Final = "GLUE_CHAT_KEY"
"""The environment variable of the endpoint's key, which is no option because options are recorded."""

_MOST_SHOWN: Final = 200  # letters of what an endpoint says
_PATH: Final = "/chat/completions"
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
        if not is_address(url):
            text = f"without a password or parameters, as it is recorded (a key is given by {KEY_VARIABLE})"
            raise ConfigError(
                f"url is an address such as http://127.0.0.1:8080/v1, {text}", settings=("url",)
            )
        parts = urlsplit(url)
        if key is not None and parts.scheme == "http" and parts.hostname not in _LOOPBACK:
            raise ConfigError("the key would travel in clear text: use https", settings=("url",))
        if not (key or "").isascii() or not (key or "").isprintable():
            raise ConfigError(f"{KEY_VARIABLE} is no key: it has letters that cannot be sent")
        self._url = url if url.endswith(_PATH) else f"{url.rstrip('/')}{_PATH}"
        self._headers = {"Content-Type": "application/json"}
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
        try:
            answer = ask("POST", self._url, seconds, json.dumps(body).encode(), self._headers)
        except NoAnswer as error:
            raise EndpointBusy(self._failed(str(error))) from None
        status, words = answer.status, answer.data.decode("utf-8", "replace")
        if 300 <= status < 400:
            words = f"a redirection to {answer.headers.get('Location')}, which is not followed"
        if status == 429 or status >= 500:
            raise EndpointBusy(self._failed(f"answered {status}: {words}"))
        if status == 200 and answer.json is not None:
            return answer.json
        raise EndpointFailed(self._failed(f"answered {status}, not with JSON: {words}"))

    def _failed(self, why: str) -> str:
        return f"the endpoint {self._url} {one_line(why, _MOST_SHOWN)}"
