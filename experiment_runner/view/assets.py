"""The page's own files, read once: no request ever leads to a path on the disk."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import BaseRoute, Route

__all__ = ["routes"]

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
    """Return a route for each file of `static/`, and for the page itself."""
    found = [path for path in sorted(_FOLDER.rglob("*")) if path.suffix in _TYPES]
    return [Route("/", _serve(_FOLDER / "index.html"))] + [
        Route(f"/static/{path.relative_to(_FOLDER).as_posix()}", _serve(path)) for path in found
    ]


def _serve(path: Path) -> object:
    content, kind = path.read_bytes(), _TYPES[path.suffix]

    async def endpoint(request: Request) -> Response:
        return Response(content, media_type=kind)

    return endpoint
