"""The page's server as a whole: which address leads to what."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route

from experiment_runner.analysis.stats import has_scipy
from experiment_runner.view import assets, episodes, stream
from experiment_runner.view.catalog import Catalog
from experiment_runner.view.curves import curves, wanted_by
from experiment_runner.view.guard import Address, Guard
from experiment_runner.view.kept import Kept
from experiment_runner.view.live import Live
from experiment_runner.view.reader import Reader
from experiment_runner.view.standing import standings_of
from experiment_runner.view.stream import Pulse
from experiment_runner.view.summary import run_in_full
from experiment_runner.view.watching import Watcher
from glue.errors import GlueError

__all__ = ["page"]

_MOST_RUNS: Final = 20


def page(folders: Sequence[Path], address: Address, token: str, pulse: Pulse) -> Guard:
    """Return the application, guarded.

    Args:
        folders: runs and folders of runs that it shows.
        address: by which names it may be called.
        token: opens it.
        pulse: what wakes its streams, and ends them.
    """
    catalog = Catalog(folders)
    catalog.find()
    read = Reader("reader", has_scipy)  # to import SciPy takes longer than any curve
    sources: dict[str, stream.Source] = {
        "runs": Watcher(catalog, pulse).open,
        "live": Live(catalog, pulse).open,
    }
    routes = [
        *assets.routes(),
        *stream.routes(pulse, sources),
        *_run_routes(catalog, read),
        *episodes.routes(catalog, Reader("recordings")),  # which can be long: nobody else waits for them
    ]
    handlers = {GlueError: _cannot_read, KeyError: _unknown, HTTPException: _refused}
    return Guard(Starlette(routes=routes, exception_handlers=handlers), address, token)


def _run_routes(catalog: Catalog, read: Reader) -> list[BaseRoute]:
    async def run(request: Request) -> Response:
        directory = catalog.entry(request.path_params["run"]).directory
        return JSONResponse(await read(lambda: run_in_full(directory)))

    async def curves_of(request: Request) -> Response:
        runs = request.query_params.getlist("run")
        if not 0 < len(runs) <= _MOST_RUNS:
            raise HTTPException(404, f"choose 1 to {_MOST_RUNS} runs")
        wanted = wanted_by([catalog.entry(run).directory for run in runs], request.query_params)
        signs = [catalog.signs(run) for run in runs]
        return JSONResponse(await read(lambda: kept.get(wanted, signs, lambda: curves(wanted))))

    async def board(request: Request) -> Response:
        run_id = request.path_params["run"]
        directory, signs = catalog.entry(run_id).directory, catalog.signs(run_id)
        return JSONResponse(await read(lambda: kept.get(directory, signs, lambda: standings_of(directory))))

    kept = Kept()
    return [
        Route("/api/run/{run}", run),
        Route("/api/curves", curves_of),
        Route("/api/standings/{run}", board),
    ]


async def _cannot_read(request: Request, error: Exception) -> Response:
    return JSONResponse({"error": str(error)}, 422)


async def _unknown(request: Request, error: Exception) -> Response:
    return JSONResponse({"error": "there is no such run"}, 404)


async def _refused(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    return JSONResponse({"error": error.detail}, error.status_code)
