"""A compiled renderer: a game as a small picture, 64 by 64 pixels of red, green and blue.

It shows the 16 rows of the window and 16 of its 21 columns, four pixels to a tile, drawn with the pictures of
`env_server.render.artwork` at a quarter of their size. The picture moves with Mario pixel by pixel.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from env_server.mario.observation import COLUMNS_SHOWN, ROWS_SHOWN, Motion, kind_of_mario, place_of
from env_server.mario.sim.state import PLANT, World
from env_server.mario.sim.tiles import SHOWN_MARIO
from env_server.render.artwork import PALETTE, SPRITES, TILES
from glue.compiled.jit import jit

SIZE: Final = 64
_TILE: Final = 4
_BESIDE: Final = 6  # tiles from the picture's border to Mario
_SPARE: Final = COLUMNS_SHOWN - SIZE // _TILE  # columns of the window that are not in the picture
_KINDS: Final = 12
_ROOM: Final = 8  # height of the tallest sprite, in pixels
_SKY: Final = "123456"
_NAMES: Final = {
    1: "ledge",
    2: "stone",
    3: "ledge",
    4: "earth",
    5: "brick",
    6: "question",
    7: "shaft left",
    8: "coin",
    9: "pole",
}
"""The picture of each tile of a view; Mario is drawn as a sprite."""
_EARTH: Final = 4
_GRASSY: Final = SHOWN_MARIO + 1
_WORDS: Final = _TILE * 3 // 4  # four bytes each, of a line of a tile
_LINE: Final = _WORDS * (SIZE // _TILE + 1)  # words of a line of all tiles that a picture may show in part


def _shrunk(lines: tuple[str, ...]) -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.bool_]]:
    """Return a picture at a quarter of its size, aligned to the bottom, and the mask of its opaque pixels."""
    missing = -len(lines) % _TILE
    lines = ("." * len(lines[0]),) * missing + lines
    lines = tuple(line + "." * (-len(line) % _TILE) for line in lines)
    opaque = np.array([[letter != "." for letter in line] for line in lines])
    colors = np.array([[PALETTE.get(letter, (0, 0, 0)) for letter in line] for line in lines], np.float64)
    height, width = len(lines) // _TILE, len(lines[0]) // _TILE
    count = opaque.reshape(height, _TILE, width, _TILE).sum((1, 3))
    total = colors.reshape(height, _TILE, width, _TILE, 3).sum((1, 3))
    mean = total / np.maximum(count, 1)[..., None]
    return mean.round().astype(np.uint8), count > _TILE * _TILE // 3


def _scenery() -> npt.NDArray[np.uint32]:
    """Return each tile before the sky of each row of tiles, (tile, row, line * word): 3 words for 4 pixels.

    The last tile is earth below the open sky, with grass on it.
    """
    sky = np.array(
        [PALETTE[_SKY[min(line * len(_SKY) // SIZE, len(_SKY) - 1)]] for line in range(SIZE)], np.uint8
    )
    shown = np.tile(sky.reshape(-1, _TILE, 1, 3), (_GRASSY + 1, 1, 1, _TILE, 1))
    for number, name in _NAMES.items():
        color, opaque = _shrunk(TILES[name])
        shown[number, :, opaque] = color[opaque][:, None]
        if number == _EARTH:
            shown[_GRASSY] = shown[_EARTH]
            shown[_GRASSY, :, 0, opaque[0]] = PALETTE["g"]
    return shown.reshape(*shown.shape[:2], -1).view(np.uint32)


def _sprite_pictures() -> tuple[npt.NDArray[np.uint8], npt.NDArray[np.bool_]]:
    colors = np.zeros((_KINDS, _ROOM, _TILE, 3), np.uint8)
    opaque = np.zeros((_KINDS, _ROOM, _TILE), np.bool_)
    for kind, lines in SPRITES.items():
        color, solid = _shrunk(lines)
        height, width = solid.shape
        left = (_TILE - width) // 2
        colors[kind, _ROOM - height :, left : left + width] = color
        opaque[kind, _ROOM - height :, left : left + width] = solid
    return colors, opaque


_SPRITE_COLORS, _SPRITE_OPAQUE = _sprite_pictures()
_SCENERY = _scenery()
_OPEN: Final = _SCENERY[0].reshape(SIZE, 1, _WORDS).repeat(SIZE // _TILE, 1).view(np.uint8).ravel()
"""A picture of nothing but the sky."""


@jit
def draw_pixels(world: World, tiles: npt.NDArray[np.uint8], pixels: npt.NDArray[np.uint8]) -> None:
    """Draw a game.

    Args:
        world: the game.
        tiles: its tiles as in the view of that name, shape (336,).
        pixels: shape (64 * 64 * 3,).
    """
    place = place_of(world, world.actors[0])
    column = world.drawn_camera // 16
    left = int(np.floor((place[0] - column - _BESIDE) * _TILE))
    left = min(max(left, 0), _SPARE * _TILE)  # pixels of the window left of the picture
    _draw_tiles(tiles, left, pixels)
    left += column * _TILE
    for i in range(world.listed - 1, -1, -1):
        actor = world.actors[world.order[i]]
        place = place_of(world, actor)
        _draw_sprite(actor.kind, place, left, pixels)
        if actor.kind <= PLANT and actor.winged:
            _draw_wing(place, left, pixels)
    place = place_of(world, world.actors[0])
    _draw_sprite(kind_of_mario(world), place, left, pixels)


@jit
def _draw_tiles(tiles: npt.NDArray[np.uint8], left: int, pixels: npt.NDArray[np.uint8]) -> None:
    """Draw whole tiles, word by word, and copy the lines from the picture's border on."""
    words = np.empty(_TILE * _LINE, np.uint32)
    drawn = words.view(np.uint8)
    hidden = left % _TILE  # pixels of the first column
    for row in range(ROWS_SHOWN):
        shown = 0
        for column in range(COLUMNS_SHOWN):
            shown |= tiles[row * COLUMNS_SHOWN + column]
        for column in range(SIZE // _TILE + 1 if shown else 0):
            cell = row * COLUMNS_SHOWN + min(left // _TILE + column, COLUMNS_SHOWN - 1)
            tile = tiles[cell]
            if tile == _EARTH and row > 0 and tiles[cell - COLUMNS_SHOWN] == 0:
                tile = _GRASSY
            for y in range(_TILE):
                for word in range(_WORDS):
                    words[y * _LINE + column * _WORDS + word] = _SCENERY[tile, row, y * _WORDS + word]
        for y in range(_TILE):
            at = (row * _TILE + y) * SIZE * 3
            for x in range(SIZE * 3):
                pixels[at + x] = drawn[y * _LINE * 4 + hidden * 3 + x] if shown else _OPEN[at + x]


@jit
def _draw_sprite(kind: int, place: Motion, left: int, pixels: npt.NDArray[np.uint8]) -> None:
    """Draw a sprite with its feet at `place`: x, height, velocity."""
    top = int(np.floor((ROWS_SHOWN - place[1]) * _TILE)) - _ROOM
    first = int(np.floor(place[0] * _TILE)) - _TILE // 2 - left
    for y in range(max(0, -top), min(_ROOM, SIZE - top)):
        for x in range(max(0, -first), min(_TILE, SIZE - first)):
            shown = x if place[2] >= 0 else _TILE - 1 - x
            if _SPRITE_OPAQUE[kind, y, shown]:
                at = ((top + y) * SIZE + first + x) * 3
                pixels[at] = _SPRITE_COLORS[kind, y, shown, 0]
                pixels[at + 1] = _SPRITE_COLORS[kind, y, shown, 1]
                pixels[at + 2] = _SPRITE_COLORS[kind, y, shown, 2]


@jit
def _draw_wing(place: Motion, left: int, pixels: npt.NDArray[np.uint8]) -> None:
    """Draw the wing of a sprite as one white pixel beside its shoulder."""
    y = int(np.floor((ROWS_SHOWN - place[1]) * _TILE)) - _TILE
    x = int(np.floor(place[0] * _TILE)) - left - (_TILE // 2 if place[2] >= 0 else 1 - _TILE // 2)
    if 0 <= y < SIZE and 0 <= x < SIZE:
        at = (y * SIZE + x) * 3
        pixels[at : at + 3] = 255
