"""The page of a season: its routes, and who may see what.

Everybody may look, without a token. A token in the address, as in `/?token=...`, is exchanged for a cookie,
and shows its entrant its own row and reasons, or the organiser everything. The cookie is the token itself: it
is as hard to guess, and still works when the page has been started again.
"""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable, Mapping
from hashlib import sha256
from pathlib import Path
from typing import ClassVar, Final

from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import BaseRoute, Route
from starlette.types import ASGIApp

from experiment_runner.competition.season.board import ORGANISER, PUBLIC
from experiment_runner.competition.season.control import NoServer, Reply, ask
from experiment_runner.view.app import application, file_routes, static_file
from experiment_runner.view.guard import READING, Address, Guard, cookie_of
from experiment_runner.view.season.metrics import metrics_of
from experiment_runner.view.season.views import Views, digest_of
from experiment_runner.view.server import Connection
from experiment_runner.view.stream import Cache, Reader, json_response

_ENTRANCE: Final = "/season/api/"
"""Prefix of the paths at which the programs of entrants sign what they send."""

_UPLOAD: Final = "/season/api/image"
_ASK_SECONDS: Final = 2.0
_MOST_REPLAYS: Final = 8
"""Replays that may wait: one thread plays them, one at a time, for seconds of a core each."""

_VIEWER: Final = "viewer"


class Passing(Connection):
    """A connection to a page that is open to all, which nobody has to admit.

    It lasts for a minute, and gives way to newer ones like any that is not admitted: a browser asks again.
    """

    head_seconds: ClassVar[float] = 60.0


class SeasonGuard(Guard):
    """Lets everybody read, and the programs of entrants send to the entrance.

    Args:
        app, address: as for `Guard`.
        viewers: who may see more, by the digest of their token.

    Attributes:
        cookie: name of the cookie with a viewer's token.
    """

    def __init__(self, app: ASGIApp, address: Address, viewers: Mapping[str, str]) -> None:
        super().__init__(app, address)
        self._viewers = viewers
        self.cookie: str = f"glue-season-{address.port}"  # cookies do not distinguish ports

    def refusal(self, request: Request) -> Response | None:
        """Return the refusal of a request that neither reads nor is for the entrance."""
        path = request.url.path
        if request.method not in READING and not path.startswith(_ENTRANCE):
            return PlainTextResponse("The page can only be read.", 405, {"Allow": ", ".join(READING)})
        viewer = self._viewers.get(digest_of(cookie_of(request, self.cookie)), PUBLIC)
        request.scope[_VIEWER] = viewer
        if viewer == ORGANISER or (path == _UPLOAD and request.method == "PUT"):  # anybody may be an entrant
            self.admit(request)
        return None


def season_page(views: Views, address: Address, entrance: Callable[[Path], list[BaseRoute]]) -> Guard:
    """Return the application, guarded.

    Args:
        views: of the season.
        address: the names by which it may be addressed.
        entrance: returns the routes below `/season/api/` for the directory of a season.

    Raises:
        ExperimentError: the season cannot be read.
    """
    directory, viewers = views.directory, dict(views.viewers())
    read, server, replays = Reader("views"), Reader("server"), Reader("replays", _MOST_REPLAYS)
    answers = Cache()

    def showing(
        content: Callable[..., bytes], kind: str = "application/json", read: Reader = read
    ) -> Callable[[Request], Awaitable[Response]]:
        """Return the endpoint that shows a viewer the content for the parameters of the path."""

        async def show(request: Request) -> Response:
            viewer = request.scope[_VIEWER]
            found = await read(lambda: content(viewer, **request.path_params))
            # The browser keeps it and asks about it, and is answered without content if it has not changed.
            tag = f'"{sha256(found).hexdigest()[:32]}"'
            headers = {"ETag": tag, "Cache-Control": "no-cache", "Vary": "Cookie"}
            if request.headers.get("if-none-match") == tag:
                return Response(status_code=304, headers=headers)
            return Response(found, media_type=kind, headers=headers)

        return show

    async def first(request: Request) -> Response:
        token = request.query_params.get("token")
        if token is None:
            return await index(request)
        viewers.update(await server(views.viewers))  # it may have enrolled a moment ago
        if digest_of(token) not in viewers:
            return PlainTextResponse("This token opens nothing here: the page itself is open to all.", 403)
        return guard.logged_in(guard.cookie, token)

    def status() -> Reply | None:
        """Return the status of the server, which is asked once a second at most."""
        found: Reply | None = answers.get("status", int(time.monotonic()), asked)
        return found

    def asked() -> Reply | None:
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
        content, kind = await read(lambda: metrics_of(views.state, found))
        return Response(content, media_type=kind)

    index = static_file("season.html")
    routes = [
        Route("/", first),
        *file_routes(),
        Route("/season.json", showing(views.board)),
        Route("/entrants/{shown}.json", showing(views.entrant)),
        Route("/feed.xml", showing(lambda _: views.feed(), "application/atom+xml")),
        Route("/replays/{shown}/{attempt:int}.json", showing(views.replays, read=replays)),
        Route(
            "/replays/{shown}/{attempt:int}/{task}/{trial:int}/{episode:int}",
            showing(views.replay, "application/octet-stream", replays),
        ),
        Route("/healthz", healthz),
        Route("/metrics", metrics),
        *entrance(directory),
    ]
    guard = SeasonGuard(application(routes, "entrant, attempt or trial"), address, viewers)
    return guard
