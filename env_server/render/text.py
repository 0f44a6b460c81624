"""Draw observations as text: Infinite Mario and the toys in characters, all others by their numbers."""

from __future__ import annotations

from typing import Final, NamedTuple

from env_server.render.scene import COLUMNS, KINDS, ROWS, Sprite, buried_cells, is_scene, read_scene
from env_server.toys import MINES_MAP
from glue.cli.screen import Marks, draw_numbers
from glue.types import Observation


class _Glyph(NamedTuple):
    text: str  # two characters
    color: str  # foreground and background, as a terminal's 256-color codes


_SKY: Final = "48;5;117"
_TILES: Final = {
    " ": _Glyph("  ", _SKY),
    "M": _Glyph("  ", _SKY),
    "7": _Glyph("##", "38;5;137;48;5;94"),
    "1": _Glyph("==", "38;5;22;48;5;71"),
    "2": _Glyph("__", f"38;5;52;{_SKY}"),
    "3": _Glyph("==", "38;5;52;48;5;71"),
    "b": _Glyph("[]", "38;5;52;48;5;173"),
    "?": _Glyph("??", "1;38;5;94;48;5;220"),
    "$": _Glyph("()", f"1;38;5;178;{_SKY}"),
    "|": _Glyph("||", "38;5;22;48;5;34"),
    "!": _Glyph("!>", f"1;38;5;160;{_SKY}"),
}
_BURIED: Final = _Glyph("::", "38;5;94;48;5;94")
_SPRITES: Final = {
    0: _Glyph("m", "1;38;5;15;48;5;160"),
    10: _Glyph("M", "1;38;5;15;48;5;160"),
    11: _Glyph("F", "1;38;5;160;48;5;15"),
    1: _Glyph("r", "1;38;5;15;48;5;124"),
    2: _Glyph("k", "1;38;5;15;48;5;22"),
    3: _Glyph("g", "1;38;5;15;48;5;52"),
    4: _Glyph("s", "1;38;5;15;48;5;89"),
    5: _Glyph("p", "1;38;5;224;48;5;28"),
    6: _Glyph("u", "1;38;5;160;48;5;230"),
    7: _Glyph("f", "1;38;5;202;48;5;230"),
    8: _Glyph("*", "1;38;5;226;48;5;202"),
    9: _Glyph("o", "1;38;5;226;48;5;22"),
}
_MARK: Final = _Glyph("..", f"1;38;5;160;{_SKY}")
_UNKNOWN: Final = _Glyph("?", "1;38;5;15;48;5;0")


def draw_text(observation: Observation, color: bool = False, marks: Marks = ()) -> list[str]:
    """Return the lines of a drawing of `observation`.

    For Infinite Mario 16 lines of 21 tiles, two characters each, and a line with Mario's speed and the names
    of the sprites in sight; for any other task its numbers. `color` adds a terminal's escape sequences;
    `marks` are x and height of points in the level, in tiles as in the observation.
    """
    if not is_scene(observation):
        return draw_numbers(observation)
    scene = read_scene(observation)
    grid = [[_TILES.get(tile, _Glyph(tile * 2, _SKY)) for tile in row] for row in scene.rows]
    for row, column in buried_cells(scene):
        grid[row][column] = _BURIED
    for x, height in marks:
        row, column = ROWS - 1 - int(height), int(x) - scene.column
        if 0 <= row < ROWS and 0 <= column < COLUMNS:
            grid[row][column] = _MARK
    in_sight = []
    for sprite in reversed(scene.sprites):  # Mario, the first, is drawn last
        row, column = sprite.cell
        if 0 <= row < ROWS and 0 <= column - scene.column < COLUMNS:
            in_sight.append(sprite)
            grid[row][column - scene.column] = _sprite_glyph(sprite)
    lines = ["".join(_paint(glyph, color) for glyph in row) for row in grid]
    mario = scene.sprites[0]
    speed = f"speed {mario.speed_x:+.2f} {mario.speed_y:+.2f} tiles/step"
    return [*lines, f"{_legend(in_sight[::-1], color)}  {speed}"]


def _sprite_glyph(sprite: Sprite) -> _Glyph:
    letter, color = _SPRITES.get(sprite.kind, _UNKNOWN)
    return _Glyph(letter + ("^" if sprite.winged else letter), color)


def _legend(sprites: list[Sprite], color: bool) -> str:
    """Return a line that names each kind of sprite once."""
    names = {}
    for sprite in sprites:
        name = ("winged " if sprite.winged else "") + KINDS.get(sprite.kind, "unknown")
        names[name] = _paint(_sprite_glyph(sprite), color)
    return "  ".join(f"{glyph} {name}" for name, glyph in names.items())


def _paint(glyph: _Glyph, color: bool) -> str:
    return f"\x1b[{glyph.color}m{glyph.text}\x1b[0m" if color else glyph.text


def draw_mines(observation: Observation, color: bool = False) -> list[str]:
    """Return the mines, two characters to a field, with the agent as `@`."""
    row, column = divmod(int(observation.ints[0]), len(MINES_MAP[0]))
    lines = [list(line) for line in MINES_MAP]
    lines[row][column] = "\x1b[1;7m@\x1b[0m" if color else "@"
    return [" ".join(line) for line in lines]


def draw_skeleton(observation: Observation, color: bool = False) -> list[str]:
    """Return the walk along 21 states, with the agent as `@` and the rewards at the ends."""
    states = ["."] * 21
    states[int(observation.ints[0])] = "\x1b[1;7m@\x1b[0m" if color else "@"
    return [f"-1 {' '.join(states)} +1"]
