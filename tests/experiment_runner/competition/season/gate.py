"""The entrance of a season over real HTTP, in front of a server whose replies a test decides."""

from __future__ import annotations

import hashlib
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from starlette.applications import Starlette
from starlette.types import Receive, Scope, Send

from experiment_runner.competition.season.control import Key, Reply, Request
from experiment_runner.competition.season.entrance import routes
from glue.client.libzmq import new_pair
from glue.client.season import PREFIX, Membership, Page, Season
from glue.errors import ExperimentError
from glue.keys.certificates import KeyPair, encode, write_pair
from glue.keys.requests import signed
from tests.experiment_runner.competition.season import inside
from tests.experiment_runner.competition.season.test_control import served
from tests.experiment_runner.view.pages import Answer, in_thread, sent

FILE = (
    inside.FILE.replace("failures = 2", 'images = true\nmost_bytes = "1m"')
    + 'final = { env = "skeleton", episodes = 3 }\n'
    + 'secret = { env = "mines", options = { level_seed = 7, random_start = false }, episodes = 3, '
    + 'rate = 50, phase = "proving", hidden = true }\n'
)


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
        _, self.secret = write_pair(folder, "alice", self.pair)
        self.port = 0

    def start(self, now: Callable[[], float] = time.time) -> None:
        """Start the page, for the first time or again."""
        self.app = Starlette(routes=routes(self.folder, now))

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
    ) -> Answer:
        """Send a request, of alice if no headers are given."""
        headers = self.headers(content, what) if headers is None else headers
        return sent(self.port, PREFIX + what, headers, "POST", content)

    def refuses(self, status: int, why: str, content: bytes = b"{}", **more: Any) -> None:
        """Send a request as `ask` does, which is refused for this reason."""
        answer = self.ask(content, **more)
        assert answer.status == status, answer
        assert why in answer.json()["error"]

    @property
    def membership(self) -> Membership:
        """What alice has of the season."""
        return Membership(self.url, "alice", self.secret, encode(new_pair().public), "token")

    @property
    def season(self) -> Season:
        """The season as her programs see it."""
        return Season(self.membership)


@pytest.fixture(scope="module")
def shared(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Entrance]:
    """An entrance of the season in a module's `TEXT`, or of the usual one."""
    text = getattr(request.module, "TEXT", FILE)
    with entrance_at(tmp_path_factory.mktemp("season") / "run", text) as entrance:
        yield entrance


@pytest.fixture
def entrance(shared: Entrance) -> Entrance:
    shared.replies.clear()
    shared.asked.clear()
    return shared


@contextmanager
def entrance_at(
    folder: Path, text: str = FILE, *, server: bool = True, now: Callable[[], float] = time.time
) -> Iterator[Entrance]:
    """Open an entrance, with a server behind it or without one."""
    folder.mkdir()
    (folder / "competition.toml").write_text(text)
    entrance = Entrance(folder)
    entrance.start(now)

    async def page(scope: Scope, receive: Receive, send: Send) -> None:
        await entrance.app(scope, receive, send)

    with ExitStack() as stack:
        if server:
            stack.enter_context(served(folder, entrance.answer))
        entrance.port = stack.enter_context(in_thread(lambda port: page, log_level="critical", ws="none"))
        yield entrance
