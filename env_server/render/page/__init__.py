"""Drawings of our environments for the page of runs: entry points of the group `glue.drawings`.

Each maps the names of files to functions that return their content; the page imports `drawing.js`.
docs/view.md describes the script.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from env_server.render.artwork import PALETTE, SPRITES, TILES
from env_server.render.drawing import CLEAR, MOUNTAINS, SKY, WIDTH, Picture, cloud, mark, pillow, sprite, tile
from env_server.toys import MINES_MAP

__all__ = ["MARIO", "TOYS"]

_FOLDER: Final = Path(__file__).parent


class _Rectangle(NamedTuple):
    """The rectangle of a part in the picture, in pixels."""

    left: int
    top: int
    width: int
    height: int


def _rectangles() -> dict[str, _Rectangle]:
    """Return the rectangles of `cloud`, `mark`, `tile NAME`, `sprite KIND right` or `left`, and `winged`."""
    return {name: rectangle for name, (rectangle, _) in _layout().items()}


def _colors() -> dict[str, list[str]]:
    """Return the colors of the sky, from the top, and of the mountains, the far ones first: `#rrggbb`."""
    return {
        name: ["#{:02x}{:02x}{:02x}".format(*PALETTE[letter]) for letter in letters]
        for name, letters in (("sky", SKY), ("mountains", MOUNTAINS))
    }


@cache
def _sheet_png() -> bytes:
    """Return the picture as PNG, transparent between the parts.

    Raises:
        ConfigError: Pillow is missing.
    """
    layout = _layout()
    height = max(rectangle.top + rectangle.height for rectangle, _ in layout.values())
    indices = np.full((height, WIDTH), CLEAR, np.uint8)
    for rectangle, part in layout.values():
        indices[
            rectangle.top : rectangle.top + rectangle.height,
            rectangle.left : rectangle.left + rectangle.width,
        ] = part
    seen = np.zeros((CLEAR + 1, 4), np.uint8)  # transparent pixels are all equal, and black
    seen[: len(PALETTE)] = [(*color, 255) for color in PALETTE.values()]
    file = io.BytesIO()
    pillow().fromarray(seen[indices]).save(file, "PNG")
    return file.getvalue()


@cache
def _layout() -> Mapping[str, tuple[_Rectangle, Picture]]:
    """Return all parts and their rectangles: in rows, the tallest first."""
    parts = {f"tile {name}": tile(name) for name in TILES} | {"cloud": cloud(), "mark": mark()}
    for kind in SPRITES:
        for winged in (False, True):
            for to_the_left, side in ((False, "right"), (True, "left")):
                parts[f"sprite {kind} {side}{' winged' if winged else ''}"] = sprite(
                    kind, to_the_left, winged
                )
    layout: dict[str, tuple[_Rectangle, Picture]] = {}
    left = top = row = 0
    for name, part in sorted(parts.items(), key=lambda item: (-len(item[1]), item[0])):
        height, width = part.shape
        if left + width > WIDTH:
            left, top, row = 0, top + row, 0
        layout[name] = _Rectangle(left, top, width, height), part
        left, row = left + width, max(row, height)
    return layout


def _artwork() -> bytes:
    return json.dumps({"places": _rectangles(), "colors": _colors()}).encode()


def _map() -> bytes:
    return json.dumps(MINES_MAP).encode()


MARIO: Final[Mapping[str, Callable[[], bytes]]] = {
    "drawing.js": (_FOLDER / "mario.js").read_bytes,
    "artwork.json": _artwork,
    "sheet.png": _sheet_png,
}
"""Infinite Mario; the sprites are one picture, which needs Pillow."""

TOYS: Final[Mapping[str, Callable[[], bytes]]] = {
    "drawing.js": (_FOLDER / "toys.js").read_bytes,
    "map.json": _map,
}
"""The mines and the skeleton's walk."""
