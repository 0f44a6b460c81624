"""Drawings of our environments for the page of runs: entry points of the group `glue.drawings`.

Each maps the names of files to functions that return their content; the page imports `drawing.js`.
docs/view.md describes the script.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable, Mapping
from functools import cache
from itertools import product
from pathlib import Path
from typing import Final

import numpy as np

from env_server.render.artwork import CLOUD, MARK, PALETTE, SPRITES, TILES
from env_server.render.drawing import CLEAR, MOUNTAINS, SKY, WIDTH, Picture, drawn, pillow, sprite
from env_server.toys import MINES_MAP

__all__ = ["MARIO", "TOYS"]

_FOLDER: Final = Path(__file__).parent


_Rectangle = tuple[int, int, int, int]
"""Left, top, width and height of a part in the picture, in pixels."""


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
    bottom = max(top + height for (_, top, _, height), _ in layout.values())
    indices = np.full((bottom, WIDTH), CLEAR, np.uint8)
    for (left, top, width, height), part in layout.values():
        indices[top : top + height, left : left + width] = part
    seen = np.zeros((CLEAR + 1, 4), np.uint8)  # transparent pixels are all equal, and black
    seen[: len(PALETTE)] = [(*color, 255) for color in PALETTE.values()]
    file = io.BytesIO()
    pillow().fromarray(seen[indices]).save(file, "PNG")
    return file.getvalue()


@cache
def _layout() -> Mapping[str, tuple[_Rectangle, Picture]]:
    """Return all parts and their rectangles: in rows, the tallest first.

    They are `cloud`, `mark`, `tile NAME`, `sprite KIND right` or `left`, and `winged`.
    """
    parts = {f"tile {name}": drawn(lines) for name, lines in TILES.items()}
    parts |= {"cloud": drawn(CLOUD), "mark": drawn(MARK)}
    for kind, winged, side in product(SPRITES, ("", " winged"), ("right", "left")):
        parts[f"sprite {kind} {side}{winged}"] = sprite(kind, side == "left", bool(winged))
    layout: dict[str, tuple[_Rectangle, Picture]] = {}
    left = top = row = 0
    for name, part in sorted(parts.items(), key=lambda item: (-len(item[1]), item[0])):
        height, width = part.shape
        if left + width > WIDTH:
            left, top, row = 0, top + row, 0
        layout[name] = (left, top, width, height), part
        left, row = left + width, max(row, height)
    return layout


def _artwork() -> bytes:
    places = {name: rectangle for name, (rectangle, _) in _layout().items()}
    return json.dumps({"places": places, "colors": _colors()}).encode()


MARIO: Final[Mapping[str, Callable[[], bytes]]] = {
    "drawing.js": (_FOLDER / "mario.js").read_bytes,
    "artwork.json": _artwork,
    "sheet.png": _sheet_png,
}
"""Infinite Mario; the sprites are one picture, which needs Pillow."""

TOYS: Final[Mapping[str, Callable[[], bytes]]] = {
    "drawing.js": (_FOLDER / "toys.js").read_bytes,
    "map.json": lambda: json.dumps(MINES_MAP).encode(),
}
"""The mines and the skeleton's walk."""
