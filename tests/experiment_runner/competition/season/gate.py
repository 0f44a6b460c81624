"""The entrance of a season over real HTTP, in front of a server whose replies a test decides."""

from __future__ import annotations

import asyncio
import hashlib
import http.client
import json
import socket
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import uvicorn
from starlette.applications import Starlette

from experiment_runner.competition.season.control import Door, Key, Reply, Request
from experiment_runner.competition.season.entrance import routes
from glue.client.libzmq import new_pair
from glue.client.season import PREFIX, Membership, Page
from glue.errors import ExperimentError
from glue.keys.certificates import KeyPair, encode, write_pair
from glue.keys.requests import signed

FILE = """\
name = "spring"
trials = 2
seed_file = "secret.txt"
[season]
opens = 2026-12-01T08:00:00Z
closes = 2026-12-22T20:00:00Z
enrol = "open"
images = true
most_bytes = "1m"
[tasks]
mines = { env = "mines", options = { random_start = true }, steps = 20, phase = "proving" }
final = { env = "skeleton", episodes = 3 }
[tasks.secret]
env = "mines"
options = { level_seed = 7, random_start = false }
episodes = 3
rate = 50
phase = "proving"
hidden = true
"""


class Entrance:
    """An entrance, its server's script, and an entrant of the season, alice.

    Attributes:
        replies: the next replies of the server, in order; an exception refuses the request.
        asked: what the server was asked for, but for keys.
        folder: of the season.
        pair: keys of alice.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.replies: list[Reply | Exception] = []
        self.asked: list[Request] = []
        self.pair = new_pair()
        self.port = 0

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    def answer(self, request: Request) -> Reply:
        if isinstance(request, Key):
            return {"key": encode(self.pair.public) if request.entrant == "alice" else None}
        self.asked.append(request)
        reply = self.replies.pop(0) if self.replies else ExperimentError("nothing is planned")
        if isinstance(reply, Exception):
            raise reply
        return reply

    def headers(
        self,
        content: bytes = b"{}",
        what: str = "attempt",
        pair: KeyPair | None = None,
        method: str = "POST",
        now: float | None = None,
    ) -> dict[str, str]:
        """Return the headers of a request of alice to the page as it was started last."""
        digest = hashlib.sha256(content).hexdigest()
        start = str(Page(self.url).ask("GET", "start")["start"])
        return signed(pair or self.pair, "alice", method, PREFIX + what, digest, start, now or time.time())

    def ask(
        self, content: bytes = b"{}", headers: Mapping[str, str] | None = None, what: str = "attempt"
    ) -> tuple[int, Mapping[str, str], Any]:
        """Send a request, of alice if no headers are given; return status, headers and body of the answer."""
        headers = self.headers(content, what) if headers is None else headers
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        try:
            connection.request("POST", PREFIX + what, content, dict(headers))
            response = connection.getresponse()
            return response.status, dict(response.headers), json.loads(response.read())
        finally:
            connection.close()

    def membership(self, folder: Path) -> Membership:
        """Return what alice has of the season, with her key in a folder."""
        _, secret = write_pair(folder, "alice", self.pair)
        return Membership(self.url, "alice", secret, encode(new_pair().public), "token")


@contextmanager
def entrance_at(
    folder: Path,
    text: str = FILE,
    *,
    server: bool = True,
    now: Callable[[], float] = time.time,
    before: Entrance | None = None,
) -> Iterator[Entrance]:
    """Open an entrance, with a server behind it or without one; or start one again."""
    folder.mkdir(exist_ok=before is not None)
    (folder / "competition.toml").write_text(text)
    entrance, over = before or Entrance(folder), threading.Event()

    def serve() -> None:
        with Door(folder) as door:
            while not over.is_set():
                door.serve(entrance.answer, 0.01)

    app = Starlette(routes=routes(folder, now))
    config = uvicorn.Config(app, log_config=None, log_level="critical", lifespan="off", ws="none")
    page = uvicorn.Server(config)
    with socket.create_server(("127.0.0.1", entrance.port)) as listening:
        entrance.port = listening.getsockname()[1]
        threads = [threading.Thread(target=lambda: asyncio.run(page.serve([listening])))]
        threads += [threading.Thread(target=serve)] if server else []
        for each in threads:
            each.start()
        try:
            while not page.started or (server and not (folder / "control").exists()):
                time.sleep(0.01)
            yield entrance
        finally:
            over.set()
            page.should_exit = True
            for each in threads:
                each.join()
