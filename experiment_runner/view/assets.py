"""The page's own files, and the drawings of installed environments: no request leads to a path on the disk.

A drawing is an entry point of the group `glue.drawings`: a table of files by name, with functions that return
their contents. The page imports its `drawing.js`; docs/view.md describes what that exports.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from starlette.exceptions import HTTPException
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

from experiment_runner.view.reader import json_response
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


def routes() -> list[BaseRoute]:
    """Return a route for each file of `static/`, for the page itself, and for the drawings.

    `/api/drawings` lists the drawings as JSON: `name`, and `problem` if it cannot be loaded. Their files are
    `/drawings/NAME/FILE`.
    """
    found = [path for path in sorted(_FOLDER.rglob("*")) if path.suffix in _TYPES]
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
        Route("/", _serve(_FOLDER / "index.html")),
        *(Route(f"/static/{path.relative_to(_FOLDER).as_posix()}", _serve(path)) for path in found),
        Route("/api/drawings", listing),
        Route("/drawings/{name}/{file}", drawing),
    ]


def _serve(path: Path) -> object:
    content = path.read_bytes()

    async def endpoint(request: Request) -> Response:
        return _response(path.name, content)

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
