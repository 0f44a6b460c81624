"""The page's application: its routes, its own files, and the drawings of installed environments.

A drawing is an entry point of the group `glue.drawings`: a table of files by name, with functions that return
their contents. The page imports its `drawing.js`; docs/view.md describes what that exports. No request leads
to a path on the disk.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

from starlette.applications import Starlette
from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from experiment_runner.view import episodes, stream
from experiment_runner.view.catalog import (
    NOTES_LIMIT,
    Catalog,
    Watcher,
    checked_notes,
    run_in_full,
    standings_of,
    write_notes,
)
from experiment_runner.view.curves import curves, drawn, wanted_by
from experiment_runner.view.guard import WRITABLE, Address, Guard, Locked
from experiment_runner.view.live import Live
from experiment_runner.view.stream import Cache, Pulse, Reader, json_response
from glue.errors import ConfigError, GlueError
from glue.installed import entry_points

Drawing = Mapping[str, Callable[[], bytes]]
"""Functions that return the contents of a drawing's files, by name."""

_FOLDER: Final = Path(__file__).with_name("static")
_TYPES: Final[Mapping[str, str]] = {
    ".css": "text/css",
    ".html": "text/html",
    ".js": "text/javascript",
    ".json": "application/json",
    ".png": "image/png",
    ".svg": "image/svg+xml",
}

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
        Route("/", static_file("index.html")),
        *file_routes(),
        *stream.routes(pulse, sources),
        *_run_routes(catalog, read),
        *episodes.routes(catalog, Reader("recordings")),  # a thread of their own, as they can be long
    ]
    return Locked(application(routes, "run"), address, token)


def application(routes: Sequence[BaseRoute], thing: str) -> Starlette:
    """Return an application that answers every error in JSON.

    Args:
        routes: of it.
        thing: what a `KeyError` of a route was looking for.
    """

    async def failed(request: Request, error: Exception) -> Response:
        match error:
            case KeyError():
                return json_response({"error": f"there is no such {thing}"}, 404)
            case HTTPException():
                return json_response({"error": error.detail}, error.status_code, error.headers)
        return json_response({"error": str(error)}, 422)

    return Starlette(
        routes=routes, exception_handlers=dict.fromkeys((GlueError, KeyError, HTTPException), failed)
    )


def _run_routes(catalog: Catalog, read: Reader) -> list[BaseRoute]:
    async def run(request: Request) -> Response:
        directory = catalog.entry(request.path_params["run"]).directory
        return json_response(await read(lambda: run_in_full(directory)))

    async def curves_of(request: Request) -> Response:
        runs = request.query_params.getlist("run")
        if not 0 < len(runs) <= _MOST_RUNS:
            raise HTTPException(404, f"choose 1 to {_MOST_RUNS} runs")
        wanted, look = wanted_by([catalog.entry(run).directory for run in runs], request.query_params)
        signs = [catalog.signs(run) for run in runs]
        return json_response(
            await read(lambda: drawn(cache.get(wanted, signs, lambda: curves(wanted)), wanted.over, look))
        )

    async def board(request: Request) -> Response:
        run_id = request.path_params["run"]
        directory, signs = catalog.entry(run_id).directory, catalog.signs(run_id)
        return json_response(await read(lambda: cache.get(directory, signs, lambda: standings_of(directory))))

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

    cache = Cache()
    return [
        Route("/api/run/{run}", run),
        Route(WRITABLE + "{run}", notes, methods=["PUT"]),
        Route("/api/curves", curves_of),
        Route("/api/standings/{run}", board),
    ]


def static_files() -> list[str]:
    """Return the names of all files of `static/`, relative to it."""
    return [
        path.relative_to(_FOLDER).as_posix() for path in sorted(_FOLDER.rglob("*")) if path.suffix in _TYPES
    ]


def static_content(name: str) -> bytes:
    """Return the content of a file of `static/`."""
    return (_FOLDER / name).read_bytes()


def file_routes() -> list[BaseRoute]:
    """Return a route for each file of `static/`, and for the drawings.

    `/api/drawings` lists the drawings as JSON: `name`, and `problem` if it cannot be loaded. Their files are
    `/drawings/NAME/FILE`.
    """
    drawings, problems = _drawings()
    listed = [{"name": name, "problem": problems.get(name)} for name in sorted(drawings | problems)]

    async def listing(request: Request) -> Response:
        return json_response(listed)

    async def drawing(request: Request) -> Response:
        name, file = request.path_params["name"], request.path_params["file"]
        if file not in drawings.get(name, {}):
            raise HTTPException(404, "there is no such drawing")
        return _response(file, _content(name, drawings[name][file]))

    return [
        *(Route(f"/static/{name}", static_file(name)) for name in static_files()),
        Route("/api/drawings", listing),
        Route("/drawings/{name}/{file}", drawing),
    ]


def static_file(name: str) -> Callable[[Request], Awaitable[Response]]:
    """Return an endpoint that answers with a file of `static/`."""
    content = static_content(name)

    async def endpoint(request: Request) -> Response:
        return _response(name, content)

    return endpoint


def _response(name: str, content: bytes) -> Response:
    return Response(content, media_type=_TYPES.get(Path(name).suffix, "application/octet-stream"))


def _drawings() -> tuple[dict[str, Drawing], dict[str, str]]:
    """Return the installed drawings, and why others cannot be loaded; both by name."""
    drawings: dict[str, Drawing] = {}
    problems: dict[str, str] = {}
    for point in entry_points("glue.drawings"):
        try:
            drawings[point.name] = dict(point.load())
        except Exception as error:  # of any kind: it is another package's module
            problems[point.name] = f"{point.value}: {type(error).__name__}: {error}"
    return drawings, problems


def _content(name: str, read: Callable[[], bytes]) -> bytes:
    try:
        return bytes(read())
    except GlueError:
        raise
    except Exception as error:
        raise ConfigError(f"the drawing {name} failed: {type(error).__name__}: {error}") from error
