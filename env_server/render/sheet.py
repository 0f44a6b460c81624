"""The artwork of Infinite Mario in one picture, for programs that draw the game themselves.

The picture is made from `env_server.render.artwork`; the page of `glue-view` draws with it in the browser.
"""

from __future__ import annotations

import io
from collections.abc import Mapping
from functools import cache
from typing import NamedTuple

import numpy as np

from env_server.render.artwork import PALETTE, SPRITES, TILES
from env_server.render.drawing import CLEAR, MOUNTAINS, SKY, WIDTH, Picture, cloud, mark, pillow, sprite, tile


class Rectangle(NamedTuple):
    """The rectangle of a part in the picture, in pixels."""

    left: int
    top: int
    width: int
    height: int


def rectangles() -> dict[str, Rectangle]:
    """Return the rectangles of `cloud`, `mark`, `tile NAME`, `sprite KIND right` or `left`, and `winged`."""
    return {name: rectangle for name, (rectangle, _) in _layout().items()}


def colors() -> dict[str, list[str]]:
    """Return the colors of the sky, from the top, and of the mountains, the far ones first: `#rrggbb`."""
    return {
        name: ["#{:02x}{:02x}{:02x}".format(*PALETTE[letter]) for letter in letters]
        for name, letters in (("sky", SKY), ("mountains", MOUNTAINS))
    }


@cache
def sheet_png() -> bytes:
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
def _layout() -> Mapping[str, tuple[Rectangle, Picture]]:
    """Return all parts and their rectangles: in rows, the tallest first."""
    parts = {f"tile {name}": tile(name) for name in TILES} | {"cloud": cloud(), "mark": mark()}
    for kind in SPRITES:
        for winged in (False, True):
            for to_the_left, side in ((False, "right"), (True, "left")):
                parts[f"sprite {kind} {side}{' winged' if winged else ''}"] = sprite(
                    kind, to_the_left, winged
                )
    layout: dict[str, tuple[Rectangle, Picture]] = {}
    left = top = row = 0
    for name, part in sorted(parts.items(), key=lambda item: (-len(item[1]), item[0])):
        height, width = part.shape
        if left + width > WIDTH:
            left, top, row = 0, top + row, 0
        layout[name] = Rectangle(left, top, width, height), part
        left, row = left + width, max(row, height)
    return layout
