"""Drawings of our environments for the page of runs: entry points of the group `glue.drawings`.

Each maps the names of files to functions that return their content; the page imports `drawing.js`.
docs/view.md describes the script.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Final

from env_server.render.sheet import colors, rectangles, sheet_png
from env_server.toys import MINES_MAP

__all__ = ["MARIO", "TOYS"]

_FOLDER: Final = Path(__file__).parent


def _artwork() -> bytes:
    return json.dumps({"places": rectangles(), "colors": colors()}).encode()


def _map() -> bytes:
    return json.dumps(MINES_MAP).encode()


MARIO: Final[Mapping[str, Callable[[], bytes]]] = {
    "drawing.js": (_FOLDER / "mario.js").read_bytes,
    "artwork.json": _artwork,
    "sheet.png": sheet_png,
}
"""Infinite Mario; the sprites are one picture, which needs Pillow."""

TOYS: Final[Mapping[str, Callable[[], bytes]]] = {
    "drawing.js": (_FOLDER / "toys.js").read_bytes,
    "map.json": _map,
}
"""The mines and the skeleton's walk."""
