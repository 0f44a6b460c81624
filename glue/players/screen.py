"""Draw what an environment shows, live in a terminal.

How the observations of an environment are drawn is up to its renderer: the entry point of the environment's
name in the group `glue.renderers`. Without one, an observation is drawn by its numbers.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable
from importlib.metadata import entry_points
from typing import Final, TextIO

from glue.closing import Closing
from glue.roles import Environment
from glue.types import Observation

__all__ = ["Renderer", "TerminalScreen", "draw_numbers", "has_color", "renderer"]

Renderer = Callable[[Observation, bool], list[str]]
"""Returns the lines of a drawing of an observation; the flag adds a terminal's escape sequences for color."""

_HOME: Final = "\x1b[H"
_CLEAR_SCREEN: Final = "\x1b[2J"
_CLEAR_TO_END_OF_LINE: Final = "\x1b[K"
_CLEAR_BELOW: Final = "\x1b[J"
_HIDE_CURSOR, _SHOW_CURSOR = "\x1b[?25l", "\x1b[?25h"
_NO_WRAP, _WRAP = "\x1b[?7l", "\x1b[?7h"


def draw_numbers(observation: Observation, color: bool = False) -> list[str]:
    """Return the observation's numbers, in one line."""
    return [repr(observation)]


def renderer(environment: Environment) -> Renderer:
    """Return the renderer of an environment, or of the installed one whose subclass it is."""
    installed = {point.value: point.name for point in entry_points(group="glue.environments")}
    renderers = {point.name: point for point in entry_points(group="glue.renderers")}
    for base in type(environment).__mro__:
        point = renderers.get(installed.get(f"{base.__module__}:{base.__qualname__}", ""))
        if point is not None:
            found: Renderer = point.load()
            return found
    return draw_numbers


def has_color(stream: TextIO) -> bool:
    """Return whether `stream` is a color terminal and NO_COLOR is not set (no-color.org)."""
    return stream.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


class TerminalScreen(Closing):
    """Draw observations in a terminal, each over the last; draw nothing if the stream is not a terminal.

    Args:
        stream: where to draw.
        draw: how observations are drawn.
        rate: maximum drawings per second; others are skipped, except the last.
        clock: returns the time in seconds.

    Attributes:
        live: whether the stream is a terminal.

    Close it, or use it as a context manager, to get the last drawing and the cursor back.
    """

    def __init__(
        self,
        stream: TextIO,
        draw: Renderer = draw_numbers,
        rate: float = 30.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._stream = stream
        self._draw_observation = draw
        self._interval = 1.0 / rate
        self._clock = clock
        self.live = stream.isatty()
        self._color = has_color(stream)
        self._next = -math.inf
        self._shown = False
        self._waiting: Callable[[], None] | None = None

    def show(
        self, observation: Observation, reward: float, step: int, episode_return: float, title: str = ""
    ) -> None:
        """Draw `observation`, and how the episode stands: the last reward, steps so far, their return."""
        if not self.live:
            return
        now = self._clock()
        if now < self._next:
            self._waiting = lambda: self._draw(observation, reward, step, episode_return, title)
            return
        self._next = now + self._interval
        self._draw(observation, reward, step, episode_return, title)

    def close(self) -> None:
        """Draw the last observation if it was skipped, and show the cursor. `show` may begin anew."""
        if self._waiting is not None:
            self._waiting()
        if self._shown:
            self._stream.write(_SHOW_CURSOR + "\n")
            self._stream.flush()
        self._shown = False
        self._next = -math.inf

    def _draw(
        self, observation: Observation, reward: float, step: int, episode_return: float, title: str
    ) -> None:
        self._waiting = None
        status = f"step {step}  reward {reward:g}  return {episode_return:.2f}"
        lines = [*self._draw_observation(observation, self._color), status, title]
        height = os.get_terminal_size(self._stream.fileno()).lines or len(lines)  # 0 is unknown
        lines = lines[-height:]
        # Line by line over the last drawing: to clear the screen for each would flicker. A line that is
        # too long must not wrap.
        begin = _HOME if self._shown else _HIDE_CURSOR + _CLEAR_SCREEN + _HOME
        drawing = f"{_CLEAR_TO_END_OF_LINE}\r\n".join(lines)
        self._stream.write(begin + _NO_WRAP + drawing + _CLEAR_BELOW + _WRAP)
        self._stream.flush()
        self._shown = True
