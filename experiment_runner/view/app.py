"""The page's server as a whole: which address leads to what."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route

from experiment_runner.view import assets, stream
from experiment_runner.view.catalog import Catalog
from experiment_runner.view.guard import Address, Guard
from experiment_runner.view.reader import Reader
from experiment_runner.view.stream import Pulse
from experiment_runner.view.summary import run_in_full
from experiment_runner.view.watching import Watcher
from glue.errors import ExperimentError

__all__ = ["page"]


def page(folders: Sequence[Path], address: Address, token: str, pulse: Pulse) -> Guard:
    """Return the application, guarded.

    Args:
        folders: runs and folders of runs that it shows.
        address: by which names it may be called.
        token: opens it.
        pulse: what wakes its streams, and ends them.
    """
    catalog = Catalog(folders)
    read = Reader("reader")
    sources: dict[str, stream.Source] = {"runs": Watcher(catalog, pulse).open}
    routes = [
        *assets.routes(),
        *stream.routes(pulse, sources),
        *_run_routes(catalog, read),
    ]
    handlers = {ExperimentError: _cannot_read, KeyError: _unknown, HTTPException: _refused}
    return Guard(Starlette(routes=routes, exception_handlers=handlers), address, token)


def _run_routes(catalog: Catalog, read: Reader) -> list[BaseRoute]:
    async def run(request: Request) -> Response:
        directory = catalog.entry(request.path_params["run"]).directory
        return JSONResponse(await read(lambda: run_in_full(directory)))

    return [Route("/api/run/{run}", run)]


async def _cannot_read(request: Request, error: Exception) -> Response:
    return JSONResponse({"error": str(error)}, 422)


async def _unknown(request: Request, error: Exception) -> Response:
    return JSONResponse({"error": "there is no such run"}, 404)


async def _refused(request: Request, error: Exception) -> Response:
    assert isinstance(error, HTTPException)
    return JSONResponse({"error": error.detail}, error.status_code)
