"""Draw observations as text: once, or live in a terminal.

Infinite Mario is drawn as a picture of characters, two to a tile; any other observation by its numbers.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from types import TracebackType
from typing import Final, NamedTuple, Self, TextIO

from env_server.render.scene import COLUMNS, KINDS, ROWS, Scene, Sprite, buried_cells, is_scene, read_scene
from glue.types import Observation

__all__ = ["TerminalScreen", "draw_text", "has_color"]


class _Glyph(NamedTuple):
    text: str  # two characters
    color: str  # foreground and background, as a terminal's 256-color codes


_HOME: Final = "\x1b[H"
_CLEAR_SCREEN: Final = "\x1b[2J"
_CLEAR_TO_END_OF_LINE: Final = "\x1b[K"
_CLEAR_BELOW: Final = "\x1b[J"
_HIDE_CURSOR, _SHOW_CURSOR = "\x1b[?25l", "\x1b[?25h"
_NO_WRAP, _WRAP = "\x1b[?7l", "\x1b[?7h"

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
_UNKNOWN: Final = _Glyph("?", "1;38;5;15;48;5;0")


def has_color(stream: TextIO) -> bool:
    """Return whether `stream` is a color terminal and NO_COLOR is not set (no-color.org)."""
    return stream.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def draw_text(observation: Observation, color: bool = False) -> list[str]:
    """Return the lines of a drawing of `observation`.

    For Infinite Mario 16 lines of 21 tiles, two characters each, and a line that names the sprites in
    sight; for any other task its numbers. `color` adds a terminal's escape sequences.
    """
    if not is_scene(observation):
        return [repr(observation)]
    scene = read_scene(observation)
    grid = [[_TILES.get(tile, _Glyph(tile * 2, _SKY)) for tile in row] for row in scene.rows]
    for row, column in buried_cells(scene):
        grid[row][column] = _BURIED
    in_sight = _in_sight(scene)
    for (row, column), sprite in reversed(in_sight):
        grid[row][column] = _sprite_glyph(sprite)
    lines = ["".join(_paint(glyph, color) for glyph in row) for row in grid]
    return [*lines, _legend([sprite for _, sprite in in_sight], color)]


class TerminalScreen:
    """Draw observations in a terminal, each over the last; draw nothing if the stream is not a terminal.

    Args:
        stream: where to draw.
        rate: maximum drawings per second; faster ones are left out, except the last.
        clock: returns the time in seconds.

    Close it, or use it as a context manager, to get the last drawing and the cursor back.
    """

    def __init__(
        self, stream: TextIO, rate: float = 30.0, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._stream = stream
        self._interval = 1.0 / rate
        self._clock = clock
        self._live = stream.isatty()
        self._color = has_color(stream)
        self._next = -math.inf
        self._shown = False
        self._waiting: Callable[[], None] | None = None

    def show(
        self, observation: Observation, reward: float, step: int, episode_return: float, title: str = ""
    ) -> None:
        """Draw `observation`, and how the episode stands: the last reward, steps so far, their return."""
        if not self._live:
            return
        now = self._clock()
        if now < self._next:
            self._waiting = lambda: self._draw(observation, reward, step, episode_return, title)
            return
        self._next = now + self._interval
        self._draw(observation, reward, step, episode_return, title)

    def close(self) -> None:
        """Draw what was left out last, and leave the cursor visible below it. `show` may begin anew."""
        if self._waiting is not None:
            self._waiting()
        if self._shown:
            self._stream.write(_SHOW_CURSOR + "\n")
            self._stream.flush()
        self._shown = False
        self._next = -math.inf

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _draw(
        self, observation: Observation, reward: float, step: int, episode_return: float, title: str
    ) -> None:
        self._waiting = None
        status = f"step {step}  reward {reward:g}  return {episode_return:.2f}{_speed(observation)}"
        lines = [*draw_text(observation, self._color), status, title]
        height = os.get_terminal_size(self._stream.fileno()).lines or len(lines)  # 0 is unknown
        lines = lines[-height:]
        # Line by line over the last drawing: to clear the screen for each would flicker. A line that is
        # too long must not wrap.
        begin = _HOME if self._shown else _HIDE_CURSOR + _CLEAR_SCREEN + _HOME
        drawing = f"{_CLEAR_TO_END_OF_LINE}\r\n".join(lines)
        self._stream.write(begin + _NO_WRAP + drawing + _CLEAR_BELOW + _WRAP)
        self._stream.flush()
        self._shown = True


def _in_sight(scene: Scene) -> list[tuple[tuple[int, int], Sprite]]:
    """Return the sprites in the drawing, each with its row and column there."""
    placed = []
    for sprite in scene.sprites:
        row, column = sprite.cell
        if 0 <= row < ROWS and 0 <= column - scene.column < COLUMNS:
            placed.append(((row, column - scene.column), sprite))
    return placed


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


def _speed(observation: Observation) -> str:
    if not is_scene(observation):
        return ""
    mario = read_scene(observation).sprites[0]
    return f"  speed {mario.speed_x:+.2f} {mario.speed_y:+.2f} tiles/step"
