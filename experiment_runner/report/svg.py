"""Learning curves as SVG, for the page of runs and for the board of a competition.

Colors are classes, which the style sheet of the page sets for light and dark. Lines that share a color differ
in their dashes, and a legend has a sample of each line. The names of lines are outside a drawing. The label
of an axis may be the name of a metric, and come from anyone.
"""

from __future__ import annotations

import html
import math
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Final, NamedTuple

from glue.console import printable

Numbers = Sequence[float | None]
"""Coordinates; None where there is no value."""

_COLORS: Final = 7
_DASHES: Final = ("", "10 4", "2 4", "10 4 2 4", "16 6", "5 3")
"""Dashes of lines; their number has no factor in common with that of the colors: 42 lines differ."""

_LEFT, _RIGHT, _TOP, _BOTTOM = 76, 30, 10, 46
_TICKS: Final = 6
_LEAST: Final = 1e-300  # number whose logarithm is taken
_Place = Callable[[float, float], tuple[float, float]]
"""A function that returns the pixel of a pair of numbers."""

_STEPS: Final = (1.0, 2.0, 5.0, 10.0)


class Line(NamedTuple):
    """A curve, with its band and the curves of its single trials; all but `at` may be empty."""

    at: Sequence[float]
    mean: Numbers
    low: Numbers = ()
    high: Numbers = ()
    single_at: Sequence[float] = ()
    singles: Sequence[Numbers] = ()


class _Scale(NamedTuple):
    """An axis: `linear`, `log`, or `symlog`, which is logarithmic on both sides of 0."""

    kind: str
    low: float
    high: float

    def share(self, value: float) -> float:
        """Return the position of a value along the axis, from 0 to 1."""
        first, last = self._bent(self.low), self._bent(self.high)
        return (self._bent(value) - first) / ((last - first) or 1.0)

    def ticks(self) -> list[float]:
        if self.kind == "linear":
            return _round_numbers(self.low, self.high)
        top = max(abs(self.low), abs(self.high), _LEAST)
        last = min(math.ceil(math.log10(top)), sys.float_info.max_10_exp)
        powers = [10.0**power for power in range(math.floor(math.log10(top)) - 5, last + 1)]
        if self.kind == "symlog":
            powers = [power for power in powers if power >= 1]
            powers = [-power for power in reversed(powers)] + [0.0, *powers]
        inside = [power for power in powers if self.low <= power <= self.high]
        return inside if len(inside) > 1 else _round_numbers(self.low, self.high)

    def _bent(self, value: float) -> float:
        if self.kind == "log":
            return math.log10(max(value, _LEAST))
        return math.copysign(math.log10(1 + abs(value)), value) if self.kind == "symlog" else value


def draw(
    lines: Sequence[Line],
    axes: tuple[str, str],
    size: tuple[int, int] = (480, 300),
    log: tuple[bool, bool] = (False, False),
    looks: Sequence[int] = (),
) -> dict[str, Any]:
    """Return a drawing as JSON.

    Args:
        lines: the curves; at least one has a point.
        axes: the labels of the two axes.
        size: width and height in pixels.
        log: whether each axis is logarithmic.
        looks: the number of each line's color and dashes, as in `sample`; empty for that of the line.

    Returns:
        `svg`, and for programs that relate pixels to numbers: `box`, the left, top, width and height of the
        part inside the axes, and `x` and `y`, the kind and ends of their scales.
    """
    width, height = size
    box = (_LEFT, _TOP, width - _LEFT - _RIGHT, height - _TOP - _BOTTOM)
    across = _scale((x for line in lines for x in line.at), log[0])
    up = _scale((y for line in lines for y in (*line.mean, *line.low, *line.high) if y is not None), log[1])

    def place(x: float, y: float) -> tuple[float, float]:
        return box[0] + box[2] * across.share(x), box[1] + box[3] * (1 - up.share(y))

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" class="drawing" viewBox="0 0 {width} {height}" '
        f'width="{width}" height="{height}">',
        *_axes(box, across, up, place, axes),
        *(
            part
            for number, (look, line) in enumerate(zip(looks or range(len(lines)), lines, strict=True))
            for part in _curve(number, look, line, place)
        ),
        "</svg>",
    ]
    return {"svg": "".join(parts), "box": box, "x": across._asdict(), "y": up._asdict()}


def sample(number: int) -> str:
    """Return a sample of the line with that number, for a legend, as SVG."""
    return (
        '<svg xmlns="http://www.w3.org/2000/svg" class="drawing sample" viewBox="0 0 42 10" width="42" '
        f'height="10"><polyline {_look(number)} points="1,5 41,5"/></svg>'
    )


def _look(number: int) -> str:
    dashes = _DASHES[number % len(_DASHES)]
    return f'class="curve c{number % _COLORS}"' + (f' stroke-dasharray="{dashes}"' if dashes else "")


def _curve(number: int, look: int, line: Line, place: _Place) -> Iterator[str]:
    yield f'<g class="trials" data-curve="{number}">'
    for values in line.singles:
        for points in _runs(line.single_at, values, place):
            yield f'<polyline class="curve single c{look % _COLORS}" points="{points}"/>'
    yield "</g>"
    band = [
        (x, low, high)
        for x, low, high in zip(line.at, line.low, line.high, strict=False)
        if low is not None and high is not None
    ]
    if band:
        edge = [(x, high) for x, _, high in band] + [(x, low) for x, low, _ in reversed(band)]
        points = " ".join(_point(*place(x, y)) for x, y in edge)
        yield f'<polygon class="band c{look % _COLORS}" points="{points}"/>'
    for points in _runs(line.at, line.mean, place):
        yield f'<polyline {_look(look)} points="{points}"/>'


def _runs(at: Sequence[float], values: Numbers, place: _Place) -> Iterator[str]:
    """Yield the points of a line; where a number is missing, the line continues to the next."""
    points = [_point(*place(x, y)) for x, y in zip(at, values, strict=True) if y is not None]
    if points:
        yield " ".join(points)


def _axes(
    box: tuple[int, int, int, int], across: _Scale, up: _Scale, place: _Place, words: tuple[str, str]
) -> Iterator[str]:
    left, top, width, height = box
    for tick in across.ticks():
        x, _ = place(tick, up.low)
        yield f'<path class="grid" d="M{x:.1f} {top}V{top + height}"/>'
        yield _text(f'x="{x:.1f}" y="{top + height + 17}"', "middle", _number(tick))
    for tick in up.ticks():
        _, y = place(across.low, tick)
        yield f'<path class="grid" d="M{left} {y:.1f}H{left + width}"/>'
        yield _text(f'x="{left - 7}" y="{y + 4:.1f}"', "end", _number(tick))
    yield _text(f'x="{left + width / 2:.0f}" y="{top + height + 37}"', "middle", words[0])
    yield _text(f'transform="translate(14 {top + height / 2:.0f}) rotate(-90)"', "middle", words[1])


def _text(position: str, anchor: str, words: str) -> str:
    return f'<text {position} text-anchor="{anchor}">{html.escape(printable(words))}</text>'


def _scale(values: Iterator[float], log: bool) -> _Scale:
    found = list(values)
    low, high = (min(found), max(found)) if found else (0.0, 1.0)
    if low == high:
        low, high = low - 0.5, high + 0.5
    return _Scale("linear" if not log else "log" if low > 0 else "symlog", low, high)


def _round_numbers(low: float, high: float) -> list[float]:
    """Return about six round numbers from `low` to `high`."""
    rough = (high - low) / _TICKS
    power = 10.0 ** math.floor(math.log10(rough)) if _LEAST < rough < math.inf else 1.0
    step = next((power * factor for factor in _STEPS if power * factor >= rough), power)
    first = math.ceil(low / step)
    return [step * number for number in range(first, first + 2 * _TICKS + 2) if step * number <= high]


def _point(x: float, y: float) -> str:
    return f"{x:.1f},{y:.1f}"


def _number(value: float) -> str:
    return f"{value:,.6g}" if abs(value) < 1e6 else f"{value:.3g}"
