"""Draw an environment's observations, live in a terminal or in a film.

An environment's renderer draws its observations: the entry point of the environment's name in the group
`glue.renderers`. Without one, an observation is drawn as its numbers. The group `glue.films` names a function
that writes a film: see `Film`.
"""

from __future__ import annotations

import inspect
import json
import math
import os
from collections.abc import Callable
from typing import Any, Final, TextIO, TypeAlias

from glue.closing import Closing
from glue.errors import ConfigError
from glue.installed import entry_points
from glue.roles import Environment
from glue.system import clock
from glue.types import Observation

Marks: TypeAlias = tuple[tuple[float, float], ...]
"""Points that an agent wants drawn, such as its plan: x and y as in the environment's observations."""
Renderer = Callable[..., list[str]]
"""Returns the lines of a drawing of an observation; a flag adds a terminal's escape sequences for color.
A third parameter, `marks`, is optional: the `Marks` to draw."""
Film = Callable[..., None]
"""Writes a film: takes a path, observations, steps per second, and the `Marks` of each observation."""
_MOST_MARKS: Final = 1000

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
    """Return the renderer of an environment, or of the installed one that it is a subclass of.

    An environment with a method `draw` that returns lines draws itself.
    """
    draw = getattr(environment, "draw", None)
    if callable(draw):
        return lambda observation, color: draw() or draw_numbers(observation)
    found: Renderer | None = _offered(environment, "glue.renderers")
    return found or draw_numbers


def film(environment: Environment) -> Film:
    """Return the film writer of an environment, or of the installed one that it is a subclass of.

    Raises:
        ConfigError: there is none.
    """
    found: Film | None = _offered(environment, "glue.films")
    if found is None:
        raise ConfigError(
            f"there are no films of {type(environment).__name__}: its name is not in glue.films"
        )
    return found


def _offered(environment: Environment, group: str) -> Any:
    """Return the entry of an environment, or of a class above it, in an entry-point group, or None."""
    installed = {point.value: point.name for point in entry_points("glue.environments")}
    points = {point.name: point for point in entry_points(group)}
    for base in type(environment).__mro__:
        point = points.get(installed.get(f"{base.__module__}:{base.__qualname__}", ""))
        if point is not None:
            return point.load()
    return None


def draws_marks(draw: Renderer) -> bool:
    """Return whether a renderer can draw marks."""
    return "marks" in inspect.signature(draw).parameters


def read_marks(answer: str) -> Marks:
    """Return the marks that an agent answered to the message `marks`: JSON, a list of pairs of numbers.

    Raises:
        ConfigError: the answer is something else, or has more than 1,000 marks.
    """
    try:
        pairs = json.loads(answer)
        if isinstance(pairs, list) and len(pairs) <= _MOST_MARKS:
            marks = tuple((float(x), float(y)) for x, y in pairs)
            if all(math.isfinite(x) and math.isfinite(y) for x, y in marks):
                return marks
    except (ValueError, TypeError, OverflowError, RecursionError):
        pass
    raise ConfigError(
        f"the agent has no plan to draw: its answer to the message marks must be a JSON list of at most "
        f"{_MOST_MARKS} pairs of numbers; it answered {answer!r:.60}"
    )


def has_color(stream: TextIO) -> bool:
    """Return whether `stream` is a color terminal and NO_COLOR is not set (no-color.org)."""
    return stream.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


class TerminalScreen(Closing):
    """Draw observations in a terminal, each over the last; draw nothing if the stream is not a terminal.

    Args:
        stream: the stream to draw on.
        draw: the drawing of an observation.
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
        clock: Callable[[], float] = clock.monotonic,
    ) -> None:
        self._stream = stream
        self._draw_observation = draw
        self._interval = 1.0 / rate
        self._clock = clock
        self.live: bool = stream.isatty()
        self._color = has_color(stream)
        self._next = -math.inf
        self._shown = False
        self._waiting: Callable[[], None] | None = None

    def show(
        self,
        observation: Observation,
        reward: float,
        step: int,
        episode_return: float,
        title: str = "",
        marks: Marks = (),
    ) -> None:
        """Draw `observation`, and the state of the episode: the last reward, steps so far, their return."""

        def draw() -> None:
            self._waiting = None
            status = f"step {step}  reward {reward:g}  return {episode_return:.2f}"
            marked = {"marks": marks} if marks else {}
            lines = [*self._draw_observation(observation, self._color, **marked), status, title]
            height = os.get_terminal_size(self._stream.fileno()).lines or len(lines)  # 0 is unknown
            # Line by line over the last drawing: clearing the screen for each would flicker. A line that is
            # too long must not wrap.
            begin = _HOME if self._shown else _HIDE_CURSOR + _CLEAR_SCREEN + _HOME
            drawing = f"{_CLEAR_TO_END_OF_LINE}\r\n".join(lines[-height:])
            self._stream.write(begin + _NO_WRAP + drawing + _CLEAR_BELOW + _WRAP)
            self._stream.flush()
            self._shown = True

        if not self.live:
            return
        now = self._clock()
        if now < self._next:
            self._waiting = draw
            return
        self._next = now + self._interval
        draw()

    def close(self) -> None:
        """Draw the last observation if it was skipped, and show the cursor. `show` may be called again."""
        if self._waiting is not None:
            self._waiting()
        if self._shown:
            self._stream.write(_SHOW_CURSOR + "\n")
            self._stream.flush()
        self._shown = False
        self._next = -math.inf
