"""A real `glue-view` and an HTTP client for it, for tests."""

from __future__ import annotations

import asyncio
import contextlib
import http.client
import json
import os
import re
import signal
import socket
import struct
import subprocess
import threading
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple, Self
from urllib.parse import unquote

import uvicorn
from starlette.types import ASGIApp

from experiment_runner.view import app
from experiment_runner.view.catalog import Catalog
from experiment_runner.view.guard import Address
from experiment_runner.view.stream import Pulse
from glue.types import Action, Observation, body_size
from tests.forked import BIN
from tests.system.runs import wait_until
from tests.terminal import Terminal, watched_terminal

_SECONDS = 100.0  # the page's server gives way to all other processes


class Answer(NamedTuple):
    """A response: its status, headers by lower-case name, and body."""

    status: int
    headers: Mapping[str, str]
    body: bytes

    def json(self) -> Any:
        return json.loads(self.body)


def sent(
    port: int, path: str, headers: Mapping[str, str], method: str = "GET", content: bytes | None = None
) -> Answer:
    """Send a request to a server of this machine; return its answer."""
    with contextlib.closing(http.client.HTTPConnection("127.0.0.1", port, timeout=_SECONDS)) as connection:
        connection.request(method, path, content, dict(headers))
        response = connection.getresponse()
        found = {name.lower(): value for name, value in response.getheaders()}
        return Answer(response.status, found, response.read())


class Page:
    """A running server, and the cookie that gives access to it."""

    def __init__(self, end: Callable[[signal.Signals], int], url: str) -> None:
        self._end = end
        self.url = url
        found = re.fullmatch(r"http://127\.0\.0\.1:(\d+)/\?token=([\w-]{20,})(?:#/\w+/\w+)?", url)
        assert found, url
        self.port, self.token = int(found[1]), found[2]
        self.cookie = ""
        self._streams: list[Stream] = []

    def log_in(self) -> Answer:
        """Exchange the token for the cookie."""
        answer = self.ask(f"/?token={self.token}", {"Cookie": ""})
        self.cookie = answer.headers["set-cookie"].partition(";")[0]
        return answer

    def ask(self, path: str, headers: Mapping[str, str] | None = None) -> Answer:
        """Send a request, with the cookie unless `headers` has another."""
        return sent(self.port, path, {"Cookie": self.cookie} | dict(headers or {}))

    def run_id(self, name: str) -> str:
        """Return the id of the run in the directory with a given name, once the page has found it."""
        with contextlib.closing(self.stream("topic=runs")) as stream:
            while True:
                for run in (stream.next().get("runs") or {}).values():
                    if run and Path(run["path"]).name == name:
                        return str(run["id"])

    def stream(self, query: str, headers: Mapping[str, str] | None = None) -> Stream:
        """Open a stream of events."""
        self._streams.append(Stream(self, query, headers))
        return self._streams[-1]

    def __enter__(self) -> Self:
        self.log_in()
        return self

    def __exit__(self, *_: object) -> None:
        while self._streams:
            self._streams.pop().close()

    def stop(self, number: signal.Signals = signal.SIGINT) -> int:
        """Send a signal; return the exit code."""
        return self._end(number)


class Inside:
    """The page in this process, without a server, with the part of `Page` that asks."""

    def __init__(self, folder: Path) -> None:
        self.port, self.token, self.cookie = 8097, "the-token", ""
        self._folder = folder
        self._app = app.page([folder], Address(self.port), self.token, Pulse())
        self.cookie = self.ask(f"/?token={self.token}").headers["set-cookie"].partition(";")[0]

    def run_id(self, name: str) -> str:
        """Return the id of the run in a directory of the folder."""
        return next(key for key, run in Catalog([self._folder]).find().items() if run.directory.name == name)

    def ask(
        self, path: str, headers: Mapping[str, str] | None = None, method: str = "GET", content: bytes = b""
    ) -> Answer:
        """Send a request, with the cookie and the host unless `headers` has others."""
        given = {"Host": f"127.0.0.1:{self.port}", "Cookie": self.cookie} | dict(headers or {})
        return asked(self._app, path, given, method, content)


@contextlib.contextmanager
def in_thread(make: Callable[[int], ASGIApp], **settings: Any) -> Iterator[int]:
    """Serve an application in a thread of this process; yield the port, for which it is made."""
    with socket.create_server(("127.0.0.1", 0)) as listening:
        port = listening.getsockname()[1]
        server = uvicorn.Server(uvicorn.Config(make(port), lifespan="off", log_config=None, **settings))
        thread = threading.Thread(target=lambda: asyncio.run(server.serve([listening])))
        thread.start()
        try:
            yield port
        finally:
            server.should_exit = True
            thread.join()


def asked(
    app: ASGIApp, path: str, headers: Mapping[str, str], method: str = "GET", content: bytes = b""
) -> Answer:
    """Return the answer of an application to a request, without a server."""
    raw, _, query = path.partition("?")
    scope = {
        "type": "http",
        "method": method,
        "path": unquote(raw),
        "raw_path": raw.encode(),
        "query_string": query.encode(),
        "headers": [(name.lower().encode(), value.encode("latin-1")) for name, value in headers.items()],
        "scheme": "http",
        "server": ("127.0.0.1", 8097),
    }
    sent: list[Any] = []

    async def receive() -> dict[str, object]:
        return {"type": "http.request", "body": content}

    async def send(message: Any) -> None:
        sent.append(message)

    asyncio.run(app(scope, receive, send))
    start, *parts = sent
    found = {name.decode().lower(): value.decode() for name, value in start["headers"]}
    return Answer(start["status"], found, b"".join(part["body"] for part in parts))


def unpacked(content: bytes) -> tuple[dict[str, Any], list[tuple[float, Action, Observation]]]:
    """Return the header of a packed episode; and the reward, action and observation of each of its steps, of
    which the first is the start.
    """
    (size,) = struct.unpack_from("<I", content)
    at, steps = 4 + size, []
    while at < len(content):
        middle = at + 8 + body_size(content, at + 8)
        end = middle + body_size(content, middle)
        action, seen = Action.from_body(content[at + 8 : middle]), Observation.from_body(content[middle:end])
        steps.append((*struct.unpack_from("<d", content, at), action, seen))
        at = end
    return json.loads(content[4 : 4 + size]), steps


class Stream:
    """An open stream of events."""

    def __init__(self, page: Page, query: str, headers: Mapping[str, str] | None = None) -> None:
        self._connection = http.client.HTTPConnection("127.0.0.1", page.port, timeout=_SECONDS)
        sent = {"Cookie": page.cookie} | dict(headers or {})
        self._connection.request("GET", f"/api/stream?{query}", headers=sent)
        self.response = self._connection.getresponse()
        self.id = ""

    def next(self) -> Any:
        """Wait for the next event except heartbeats, which are empty; return its data, or None at the end."""
        while line := self.response.readline():
            if line.startswith(b"id: "):
                self.id = line[4:].decode().strip()
            elif line.startswith(b"data: ") and (data := json.loads(line[6:])):
                return data
        return None

    def close(self) -> None:
        self.response.close()
        self._connection.close()


def glue_view(*arguments: object, cwd: Path | None = None) -> contextlib.AbstractContextManager[Page]:
    """Run `glue-view` at a free port until the context ends."""
    command = ("glue-view", *map(str, arguments), "--no-browser", "--port", "0")
    return shown_by(*command, cwd=cwd or Path.cwd())


@contextlib.contextmanager
def shown_by(*command: str, cwd: Path) -> Iterator[Page]:
    """Run a command that serves a page until the context ends."""
    terminal = Terminal(*command, cwd=cwd)

    def end(number: signal.Signals) -> int:
        terminal.send_signal(number)
        return terminal.end()

    try:
        with Page(end, terminal.wait_for(r"http://\S+token=\S+")[0]) as page:
            yield page
    finally:
        terminal.close()


@contextlib.contextmanager
def in_terminal(*command: str, cwd: Path) -> Iterator[tuple[Page, list[bytes]]]:
    """Run one of our commands with `--view` in a terminal; yield its page, and the output there."""
    with (
        watched_terminal() as (writing, seen),
        subprocess.Popen(
            [BIN / command[0], *command[1:], "--view"],
            cwd=cwd,
            env={name: value for name, value in os.environ.items() if "DISPLAY" not in name},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=writing,
        ) as process,
    ):

        def end(number: signal.Signals) -> int:
            process.send_signal(number)
            return process.wait(_SECONDS)

        try:
            wait_until(lambda: re.search(rb"token=\S+\s", b"".join(seen)), "the page's address")
            with Page(end, re.findall(r"http://\S+", b"".join(seen).decode())[0]) as page:
                yield page, seen
        finally:
            process.kill()
