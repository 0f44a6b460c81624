"""The page's own files, and what games are drawn with, read once: no request leads to a path on the disk."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Final

from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.routing import BaseRoute, Route

from env_server.render.sheet import colors, places, sheet_png
from env_server.toys import MINES_MAP

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
    """Return a route for each file of `static/`, for the page itself, and for `/api/artwork`.

    The last is JSON: the places in the sprite sheet `/api/artwork.png`, colors, and the map of the mines.
    """
    found = [path for path in sorted(_FOLDER.rglob("*")) if path.suffix in _TYPES]
    return (
        [Route("/", _serve(_FOLDER / "index.html"))]
        + [Route(f"/static/{path.relative_to(_FOLDER).as_posix()}", _serve(path)) for path in found]
        + [Route("/api/artwork", _artwork), Route("/api/artwork.png", _sheet)]
    )


def _serve(path: Path) -> object:
    content, kind = path.read_bytes(), _TYPES[path.suffix]

    async def endpoint(request: Request) -> Response:
        return Response(content, media_type=kind)

    return endpoint


async def _artwork(request: Request) -> Response:
    return JSONResponse({"places": places(), "colors": colors(), "mines": MINES_MAP})


async def _sheet(request: Request) -> Response:
    return Response(sheet_png(), media_type="image/png")
