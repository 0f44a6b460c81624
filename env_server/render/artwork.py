"""The sprites and tiles with which Infinite Mario is drawn: our own, in artwork.txt, one letter per pixel.

`PALETTE` gives each letter its color; a dot is transparent. Sprites face right and stand on their
last line; a tile is 16 by 16 pixels. Halves are mirrored. The letters c and C are a koopa's colors.
"""

from __future__ import annotations

from importlib import resources
from typing import Final, TypeAlias

PALETTE: Final = {
    "k": (0x2A, 0x1B, 0x2E),  # outline
    "w": (0xFF, 0xFF, 0xFF),
    "r": (0xE3, 0x3B, 0x3B),
    "R": (0xA8, 0x1F, 0x33),
    "b": (0x3B, 0x6F, 0xD9),
    "B": (0x24, 0x46, 0x9C),
    "t": (0xFF, 0xD0, 0xA3),  # skin
    "T": (0xE3, 0x9E, 0x72),
    "n": (0x8C, 0x54, 0x2F),  # earth
    "N": (0x64, 0x38, 0x24),
    "m": (0xA8, 0x6B, 0x3C),
    "y": (0xFF, 0xD8, 0x4A),
    "Y": (0xE0, 0x9A, 0x1F),
    "o": (0xF4, 0x7F, 0x2B),
    "g": (0x4F, 0xB8, 0x3F),  # grass
    "G": (0x2C, 0x82, 0x34),
    "l": (0x9A, 0xDE, 0x5B),
    "p": (0xB0, 0x57, 0xC9),  # spikes
    "P": (0x6F, 0x2F, 0x8A),
    "s": (0xC2, 0xC8, 0xD6),  # stone
    "S": (0x87, 0x8F, 0xA8),
    "d": (0x5C, 0x63, 0x7F),
    "h": (0x7C, 0xCB, 0x6E),  # hill, behind
    "H": (0x69, 0xB8, 0x60),
    "1": (0x5F, 0xA8, 0xF0),  # sky, from the top
    "2": (0x74, 0xB7, 0xF4),
    "3": (0x8B, 0xC6, 0xF7),
    "4": (0xA4, 0xD5, 0xF9),
    "5": (0xBE, 0xE3, 0xFB),
    "6": (0xD8, 0xF0, 0xFD),
    "7": (0x9C, 0xCF, 0xD8),  # mountains far away
    "8": (0x86, 0xC2, 0xB4),
}

Lines: TypeAlias = tuple[str, ...]
"""A picture, from the top: a letter of `PALETTE`, or a dot, per pixel."""


def _read() -> dict[str, Lines]:
    """Return the pictures of artwork.txt by name; an empty line separates them."""
    text = resources.files("env_server.render").joinpath("artwork.txt").read_text(encoding="ascii")
    blocks = (block.split("\n") for block in text.rstrip().split("\n\n"))
    return {name: tuple(lines) for name, *lines in blocks}


def _whole(half: Lines) -> Lines:
    return tuple(line + line[::-1] for line in half)


def _recolored(picture: Lines, letters: str, by: str) -> Lines:
    return tuple(line.translate(str.maketrans(letters, by)) for line in picture)


_PICTURES: Final = _read()

TILES: Final = {
    name.removeprefix("tile "): lines for name, lines in _PICTURES.items() if name.startswith("tile ")
}

SPRITES: Final = {
    0: _PICTURES["mario small"],
    10: _PICTURES["mario large"],
    11: _recolored(_PICTURES["mario large"], "rRbB", "wsrR"),  # with the fire flower
    1: _recolored(_PICTURES["koopa"], "cC", "rR"),
    2: _recolored(_PICTURES["koopa"], "cC", "gG"),
    3: _whole(_PICTURES["goomba half"]),
    4: _PICTURES["spiky"],
    5: _whole(_PICTURES["plant half"]),
    6: _whole(_PICTURES["mushroom half"]),
    7: _whole(_PICTURES["flower half"]),
    8: _PICTURES["fireball"],
    9: _PICTURES["shell"],
}
"""Sprites by their kind in observations."""

WING: Final = _PICTURES["wing"]
CLOUD: Final = _PICTURES["cloud"]
MARK: Final = _PICTURES["mark"]
