"""The page of a season: its routes, and who may see what.

Everybody may look, without a token. A token in the address, as in `/?token=...`, is exchanged for a cookie,
and shows its entrant its own row and reasons, or the organiser everything. The cookie is the token itself: it
is as hard to guess, and still works when the page has been started again.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from datetime import UTC, datetime
from hashlib import sha256
from pathlib import Path
from typing import Final

from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import BaseRoute, Route
from starlette.types import ASGIApp

from experiment_runner.competition.season.board import PUBLIC
from experiment_runner.competition.season.control import NoServer, Reply, ask
from experiment_runner.view.app import application, file_routes, static_file
from experiment_runner.view.guard import READING, Address, Guard, cookie_of
from experiment_runner.view.reader import Reader, json_response
from experiment_runner.view.season.boards import Boards, digest_of
from experiment_runner.view.season.metrics import metrics_of
from experiment_runner.view.season.replays import Replays
from experiment_runner.view.server import Connection

_ENTRANCE: Final = "/season/api/"
"""Prefix of the paths at which the programs of entrants sign what they send."""

_UPLOAD: Final = "/season/api/image"
_ASK_SECONDS: Final = 2.0
_VIEWER: Final = "viewer"


def utc_now() -> datetime:
    """Return the time."""
    return datetime.now(UTC)


class Passing(Connection):
    """A connection to a page that is open to all, which nobody has to admit.

    It lasts for a minute, and gives way to newer ones like any that is not admitted: a browser asks again.
    """

    head_seconds = 60.0


class SeasonGuard(Guard):
    """Lets everybody read, and the programs of entrants send to the entrance.

    Args:
        app, address: as for `Guard`.
        viewers: who may see more, by the digest of their token.
    """

    def __init__(self, app: ASGIApp, address: Address, viewers: Mapping[str, str]) -> None:
        super().__init__(app, address)
        self._viewers = viewers
        self._cookie = _cookie(address)

    def refusal(self, request: Request) -> Response | None:
        """Return the refusal of a request that neither reads nor is for the entrance."""
        path = request.url.path
        if request.method not in READING and not path.startswith(_ENTRANCE):
            return PlainTextResponse("The page can only be read.", 405, {"Allow": ", ".join(READING)})
        viewer = self._viewers.get(digest_of(cookie_of(request, self._cookie)), PUBLIC)
        request.scope[_VIEWER] = viewer
        if viewer != PUBLIC or (path == _UPLOAD and request.method == "PUT"):
            self.admit(request)
        return None


def season_page(
    directory: Path,
    address: Address,
    entrance: Callable[[Path], list[BaseRoute]],
    clock: Callable[[], datetime],
) -> Guard:
    """Return the application, guarded.

    Args:
        directory: of the season.
        address: the names by which it may be addressed.
        entrance: returns the routes below `/season/api/`.
        clock: returns the time.

    Raises:
        ExperimentError: the season cannot be read.
    """
    viewers: dict[str, str] = Boards(directory, clock).viewers()
    # The public does not wait for the boards of those who see more.
    public, own, played = (Boards(directory, clock) for _ in range(3))
    reads = {True: Reader("public"), False: Reader("own")}
    server, replays = Reader("server"), Replays()

    async def read(request: Request, what: Callable[[Boards, str], bytes]) -> bytes:
        viewer = request.scope[_VIEWER]
        is_public = viewer == PUBLIC
        return await reads[is_public](lambda: what(public if is_public else own, viewer))

    async def first(request: Request) -> Response:
        token = request.query_params.get("token")
        if token is None:
            return await index(request)
        viewers.update(await server(public.viewers))  # it may have enrolled a moment ago
        if digest_of(token) not in viewers:
            return PlainTextResponse("This token opens nothing here: the page itself is open to all.", 403)
        return guard.logged_in(_cookie(address), token)

    async def board(request: Request) -> Response:
        return _unchanged_or(request, await read(request, Boards.board), "application/json")

    async def entrant(request: Request) -> Response:
        name = request.path_params["name"]
        content = await read(request, lambda boards, viewer: boards.entrant(viewer, name))
        return _unchanged_or(request, content, "application/json")

    async def feed(request: Request) -> Response:
        return _unchanged_or(request, await reads[True](lambda: public.feed(PUBLIC)), "application/atom+xml")

    async def listing(request: Request) -> Response:
        viewer, (name, attempt) = request.scope[_VIEWER], request.path_params.values()
        content = await replays(lambda: played.replays(viewer, name, attempt))
        return _unchanged_or(request, content, "application/json")

    async def replay(request: Request) -> Response:
        viewer, where = request.scope[_VIEWER], request.path_params.values()
        content = await replays(lambda: played.replay(viewer, *where))
        return _unchanged_or(request, content, "application/octet-stream")

    def status() -> Reply | None:
        try:
            return ask(directory, {"do": "status"}, _ASK_SECONDS)
        except NoServer:
            return None

    async def healthz(request: Request) -> Response:
        found = await server(status)
        why = "no server answers: nothing is played" if found is None else found.get("why", "")
        return json_response({"ok": found is not None, "why": why}, 503 if found is None else 200)

    async def metrics(request: Request) -> Response:
        found = await server(status)
        content, kind = await reads[True](lambda: metrics_of(public.view(PUBLIC), found))
        return Response(content, media_type=kind)

    index: Callable[[Request], Awaitable[Response]] = static_file("season.html")
    routes = [
        Route("/", first),
        *file_routes(),
        Route("/season.json", board),
        Route("/entrants/{name}.json", entrant),
        Route("/feed.xml", feed),
        Route("/replays/{name}/{attempt:int}.json", listing),
        Route("/replays/{name}/{attempt:int}/{task}/{trial:int}/{episode:int}", replay),
        Route("/healthz", healthz),
        Route("/metrics", metrics),
        *entrance(directory),
    ]
    guard = SeasonGuard(application(routes, "entrant, attempt or trial"), address, viewers)
    return guard


def _cookie(address: Address) -> str:
    return f"glue-season-{address.port}"  # cookies do not distinguish ports


def _unchanged_or(request: Request, content: bytes, kind: str) -> Response:
    """Return a response that the browser keeps and asks about, without content if it has not changed."""
    tag = f'"{sha256(content).hexdigest()[:32]}"'
    headers = {"ETag": tag, "Cache-Control": "no-cache", "Vary": "Cookie"}
    if request.headers.get("if-none-match") == tag:
        return Response(status_code=304, headers=headers)
    return Response(content, media_type=kind, headers=headers)
