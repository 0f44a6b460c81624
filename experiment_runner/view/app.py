"""The page's server as a whole, with its routes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from experiment_runner.view import assets, episodes, stream
from experiment_runner.view.catalog import NOTES_LIMIT, Catalog, Watcher, checked_notes, write_notes
from experiment_runner.view.curves import curves, drawn, look_of, wanted_by
from experiment_runner.view.guard import WRITABLE, Address, Guard
from experiment_runner.view.live import Live
from experiment_runner.view.reader import Kept, Reader, json_response
from experiment_runner.view.stream import Pulse
from experiment_runner.view.summary import run_in_full, standings_of
from glue.errors import GlueError

_MOST_RUNS: Final = 20


def page(folders: Sequence[Path], address: Address, token: str, pulse: Pulse) -> Guard:
    """Return the application, guarded.

    Args:
        folders: runs and folders of runs that it shows.
        address: the names by which it may be addressed.
        token: secret that opens it.
        pulse: wakes its streams, and ends them.
    """
    catalog = Catalog(folders)
    catalog.find()
    read = Reader("reader")
    sources: dict[str, stream.Source] = {
        "runs": Watcher(catalog, pulse).open,
        "live": Live(catalog, pulse).open,
    }
    routes = [
        *assets.routes(),
        *stream.routes(pulse, sources),
        *_run_routes(catalog, read),
        *episodes.routes(catalog, Reader("recordings")),  # a thread of their own, as they can be long
    ]
    handlers = dict.fromkeys((GlueError, KeyError, HTTPException), _error)
    return Guard(Starlette(routes=routes, exception_handlers=handlers), address, token)


def _run_routes(catalog: Catalog, read: Reader) -> list[BaseRoute]:
    async def run(request: Request) -> Response:
        directory = catalog.entry(request.path_params["run"]).directory
        return json_response(await read(lambda: run_in_full(directory)))

    async def curves_of(request: Request) -> Response:
        runs = request.query_params.getlist("run")
        if not 0 < len(runs) <= _MOST_RUNS:
            raise HTTPException(404, f"choose 1 to {_MOST_RUNS} runs")
        wanted = wanted_by([catalog.entry(run).directory for run in runs], request.query_params)
        signs = [catalog.signs(run) for run in runs]
        look = look_of(request.query_params)
        return json_response(
            await read(lambda: drawn(kept.get(wanted, signs, lambda: curves(wanted)), wanted.over, look))
        )

    async def board(request: Request) -> Response:
        run_id = request.path_params["run"]
        directory, signs = catalog.entry(run_id).directory, catalog.signs(run_id)
        return json_response(await read(lambda: kept.get(directory, signs, lambda: standings_of(directory))))

    async def notes(request: Request) -> Response:
        directory = catalog.entry(request.path_params["run"]).directory
        content = bytearray()
        async for chunk in request.stream():
            content += chunk
            if len(content) > NOTES_LIMIT:
                raise HTTPException(413, "the note is too long")
        found = checked_notes(bytes(content))
        await read(lambda: write_notes(directory, found))
        return json_response(found)

    kept = Kept()
    return [
        Route("/api/run/{run}", run),
        Route(WRITABLE + "{run}", notes, methods=["PUT"]),
        Route("/api/curves", curves_of),
        Route("/api/standings/{run}", board),
    ]


async def _error(request: Request, error: Exception) -> Response:
    match error:
        case KeyError():
            return json_response({"error": "there is no such run"}, 404)
        case HTTPException():
            return json_response({"error": error.detail}, error.status_code)
    return json_response({"error": str(error)}, 422)
