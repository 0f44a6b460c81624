"""Ranges of numbers, and spaces made of them, as a task spec describes observations and actions.

Public through `glue.taskspec`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt

from glue.errors import LocalProtocolError, TaskSpecError
from glue.types import AbstractType

Bound = int | float | None

NEGINF: Final = -math.inf
POSINF: Final = math.inf
UNSPEC: Final = None

MAX_COUNT: Final = 2**24  # Of ints, of doubles and of chars: more would not fit into a body.
INT32_MIN: Final = -(2**31)
INT32_MAX: Final = 2**31 - 1
_DOUBLE_MAX: Final = float(np.finfo(np.float64).max)
_WINDOW: Final = 100.0
_FEW: Final = 32  # A Python loop is faster than NumPy up to about twice as many, four times faster for three.


@dataclass(frozen=True, slots=True)
class Range:
    """The range of one number, ends included.

    Args:
        low: the minimum; NEGINF if there is none, UNSPEC if it is not stated.
        high: the maximum; POSINF if there is none, UNSPEC if it is not stated.

    Raises:
        TaskSpecError: `low` is above `high`, or a bound is not a number that a double holds exactly.

    A bound that is not stated allows everything. NaN is in no range.
    """

    low: Bound = UNSPEC
    high: Bound = UNSPEC

    def __post_init__(self) -> None:
        for bound in (self.low, self.high):
            if bound is not UNSPEC and not _is_double(bound):
                raise TaskSpecError(f"a bound must be a number that a double holds exactly, not {bound}")
        if self.low == POSINF or self.high == NEGINF:
            raise TaskSpecError("a minimum cannot be POSINF (inf), nor a maximum NEGINF (-inf)")
        low, high = self.ends
        if low > high:
            raise TaskSpecError(f"the minimum {self.low} is above the maximum {self.high}")

    @property
    def ends(self) -> tuple[float, float]:
        """The bounds as numbers; infinite if there is none or it is not stated."""
        return NEGINF if self.low is None else self.low, POSINF if self.high is None else self.high

    def __contains__(self, number: float) -> bool:
        low, high = self.ends
        return low <= number <= high

    def __str__(self) -> str:
        return _range_text(1, self, float)


Run = tuple[int, Range]


@dataclass(frozen=True, slots=True)
class Ranges:
    """The ranges of a sequence of numbers, one for each, stored as runs of equal ranges.

    ``ranges[i]`` is the range of number i, and ``len(ranges)`` the number of ranges; a run of a million
    takes no more memory than a run of two. Two objects are equal if every number has the same range in both.

    Args:
        runs: pairs of a repeat (0 or more) and the range it repeats; see also `of`.

    Raises:
        TaskSpecError: a repeat is negative, or there are more than 2**24 numbers.
    """

    runs: tuple[Run, ...] = ()
    _stops: npt.NDArray[np.int64] = field(init=False, repr=False, compare=False)
    _ends: npt.NDArray[np.float64] = field(init=False, repr=False, compare=False)
    _few: tuple[tuple[float, float], ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        runs: list[Run] = []
        count = 0
        for repeat, range_ in self.runs:
            if repeat < 0:
                raise TaskSpecError(f"a range cannot be repeated {repeat} times")
            count += repeat
            if count > MAX_COUNT:
                raise TaskSpecError(f"{count} numbers are more than the {MAX_COUNT} that a space may have")
            if runs and runs[-1][1] == range_:
                runs[-1] = (runs[-1][0] + repeat, range_)
            elif repeat:
                runs.append((repeat, range_))
        stops = np.cumsum([repeat for repeat, _ in runs], dtype=np.int64)
        ends = np.array([range_.ends for _, range_ in runs], np.float64).reshape(-1, 2).T
        object.__setattr__(self, "runs", tuple(runs))
        object.__setattr__(self, "_stops", stops)
        object.__setattr__(self, "_ends", ends)
        object.__setattr__(self, "_few", tuple(range_.ends for range_ in self) if count <= _FEW else ())

    @classmethod
    def of(cls, *ranges: Range) -> Self:
        """Return the sequence of `ranges`, one for each number."""
        return cls(tuple((1, range_) for range_ in ranges))

    def __len__(self) -> int:
        return int(self._stops[-1]) if self.runs else 0

    def __getitem__(self, index: int) -> Range:
        count = len(self)
        if not -count <= index < count:
            raise IndexError(f"there is no range {index}; there are {count}")
        return self.runs[int(self._stops.searchsorted(index % count, side="right"))][1]

    def __iter__(self) -> Iterator[Range]:
        for repeat, range_ in self.runs:
            yield from itertools.repeat(range_, repeat)

    def first_outside(self, numbers: npt.NDArray[np.int32] | npt.NDArray[np.float64]) -> int | None:
        """Return the index of the first of `numbers`, shape (len(self),), that is out of its range."""
        if self._few:
            for index, (number, (low, high)) in enumerate(zip(numbers.tolist(), self._few, strict=True)):
                if not low <= number <= high:
                    return index
            return None
        lows, highs = self._ends.repeat(np.diff(self._stops, prepend=0), axis=1)
        inside = (lows <= numbers) & (numbers <= highs)
        return None if inside.all() else int(inside.argmin())


@dataclass(frozen=True, slots=True)
class Space:
    """The space of observations or actions.

    Args:
        ints: a range for each int, its bounds whole numbers of 32 bits.
        doubles: a range for each double.
        chars: the number of chars.
        stated: False if the task spec does not state the space; then any value is allowed, and the other
            arguments are left out.

    Raises:
        TaskSpecError: a bound of an int is not whole or does not fit 32 bits, or `chars` is out of range.
    """

    ints: Ranges = Ranges()
    doubles: Ranges = Ranges()
    chars: int = 0
    stated: bool = True
    counts: tuple[int, int, int] = field(init=False, repr=False, compare=False)
    """The number of ints, doubles and chars."""

    def __post_init__(self) -> None:
        for _, range_ in self.ints.runs:
            for bound in range_.ends:
                if math.isfinite(bound) and not _is_int32(bound):
                    raise TaskSpecError(
                        f"a bound of an int is a whole number from {INT32_MIN} to {INT32_MAX}, not {bound}"
                    )
        if not 0 <= self.chars <= MAX_COUNT:
            raise TaskSpecError(f"the number of chars is from 0 to {MAX_COUNT}, not {self.chars}")
        object.__setattr__(self, "counts", (len(self.ints), len(self.doubles), self.chars))
        if not self.stated and any(self.counts):
            raise TaskSpecError("a space that is not stated has no ints, doubles or chars")

    def check(self, value: AbstractType) -> str | None:
        """Return why `value` is not in this space, or None if it is.

        Counts and bounds are checked; a bound that is not stated allows everything. The text names the first
        number outside its range, counted from 0: ``int 1 is 3, not in (0 1)``.
        """
        if not self.stated:
            return None
        if value.counts != self.counts:
            kinds = zip(("ints", "doubles", "chars"), self.counts, value.counts, strict=True)
            return "; ".join(
                f"{kind}: {right} expected, {count} received"
                for kind, right, count in kinds
                if right != count
            )
        ints, doubles, _ = self.counts
        if ints and (index := self.ints.first_outside(value.ints)) is not None:
            return f"int {index} is {value.ints[index]}, not in {_range_text(1, self.ints[index], int)}"
        if doubles and (index := self.doubles.first_outside(value.doubles)) is not None:
            return f"double {index} is {value.doubles[index]}, not in {self.doubles[index]}"
        return None

    def still(self) -> tuple[list[int], list[float], bytes]:
        """Return ints, doubles and chars of standing still: zero, or the legal number nearest to it.

        They are empty if the space is not stated.
        """
        ints = [int(number) for number in _nearest(self.ints)]
        return ints, _nearest(self.doubles), b" " * self.chars

    def sample(
        self, generator: np.random.Generator
    ) -> tuple[npt.NDArray[np.int32], npt.NDArray[np.float64], bytes]:
        """Return ints, doubles and chars drawn uniformly: ``Action(*space.sample(generator))``.

        A number with one bound is drawn within 100 of it, a number without bounds from -100 to 100; chars
        from all 256.

        Raises:
            LocalProtocolError: the space is not stated.
        """
        if not self.stated:
            raise LocalProtocolError(
                "the task spec does not state this space, so nothing can be drawn from it"
            )
        ints = [np.empty(0, np.int64)]
        for repeat, range_ in self.ints.runs:
            low, high = window(range_, INT32_MIN, INT32_MAX)
            ints.append(generator.integers(int(low), int(high), repeat, endpoint=True))
        doubles = [np.empty(0, np.float64)]
        for repeat, range_ in self.doubles.runs:
            low, high = window(range_, -_DOUBLE_MAX, _DOUBLE_MAX)
            share = generator.random(repeat)
            # Not low + (high - low) * share: the difference of two doubles may be infinite.
            doubles.append(np.clip(low * (1 - share) + high * share, low, high))
        return np.concatenate(ints).astype(np.int32), np.concatenate(doubles), generator.bytes(self.chars)

    def __str__(self) -> str:
        parts = []
        if self.ints:
            parts += ["INTS", _ranges_text(self.ints, int)]
        if self.doubles:
            parts += ["DOUBLES", _ranges_text(self.doubles, float)]
        if self.chars:
            parts += ["CHARCOUNT", str(self.chars)]
        return " ".join(parts)


def equal_runs(low: npt.NDArray[Any], high: npt.NDArray[Any]) -> Iterator[tuple[int, Any, Any]]:
    """Yield how often each pair of bounds comes in succession, and the pair; both arrays are flat."""
    if not len(low):
        return
    changes = (np.flatnonzero((low[1:] != low[:-1]) | (high[1:] != high[:-1])) + 1).tolist()
    for start, stop in zip([0, *changes], [*changes, len(low)], strict=True):
        yield stop - start, low[start].item(), high[start].item()


def _nearest(ranges: Ranges) -> list[float]:
    """Return of each range the number that is nearest to zero."""
    return [min(max(0, low), high) for low, high in (range_.ends for range_ in ranges)]


def _is_double(bound: float) -> bool:
    try:
        return bool(float(bound) == bound)
    except OverflowError:
        return False


def _is_int32(bound: float) -> bool:
    return isinstance(bound, (int, np.integer)) and INT32_MIN <= bound <= INT32_MAX


def window(range_: Range, least: float, largest: float) -> tuple[float, float]:
    """Return finite bounds, both from `least` to `largest`, between which to draw a number of `range_`."""
    low, high = range_.ends
    if math.isinf(low) and math.isinf(high):
        low, high = -_WINDOW, _WINDOW
    elif math.isinf(low):
        low = high - _WINDOW
    elif math.isinf(high):
        high = low + _WINDOW
    return max(low, least), min(high, largest)


def _range_text(repeat: int, range_: Range, number: type[float]) -> str:
    """Return a range as in a task spec, with bounds written as `number`s: int or float."""
    texts = []
    for bound in (range_.low, range_.high):
        if bound is UNSPEC:
            texts.append("UNSPEC")
        elif math.isinf(bound):
            texts.append("NEGINF" if bound < 0 else "POSINF")
        else:
            texts.append(repr(number(bound)))
    return f"({' '.join(texts if repeat == 1 else [str(repeat), *texts])})"


def _ranges_text(ranges: Ranges, number: type[float]) -> str:
    return " ".join(_range_text(repeat, range_, number) for repeat, range_ in ranges.runs)
