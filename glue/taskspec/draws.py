"""Values drawn at random from a space, many at once: drawing one at a time takes NumPy longer than a step.

The values are those of `Space.sample` called once for each: the same generator gives the same values, and
ends in the same state.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from glue.taskspec.space import INT32_MAX, INT32_MIN, Space, window
from glue.types import PREFIX_SIZE, AbstractType

_AT_ONCE: Final = 1024
"""Maximum number of numbers drawn at once."""

_WORD: Final = 4
"""Size in bytes of the numbers from which `Generator.bytes` takes its bytes; it draws at least one."""


class Draws:
    """Generator of uniform random values of a space, the same as those of `Space.sample`.

    Args:
        space: the space to draw from. Values with doubles are drawn one by one.
        generator: made by `np.random.default_rng`. Until `settle`, nothing else may draw from it.
    """

    def __init__(self, space: Space, generator: np.random.Generator) -> None:
        self._space = space
        self._generator = generator
        self._ints, doubles, self._chars = space.counts
        words = max(1, -(-self._chars // _WORD))
        self._values = _AT_ONCE // (self._ints + words) if space.stated and not doubles else 0
        if self._values:
            ends = [window(range_, INT32_MIN, INT32_MAX) for range_ in space.ints]
            self._lows, self._highs = np.array(ends + [(0, 2**32 - 1)] * words).astype(np.int64).T
        self._next = 1  # number of values drawn at once the next time, so that settling often costs little
        self._count = 0  # of those drawn the last time
        self._before = generator.bit_generator.state
        self._ahead: list[bytes] = []

    def draw(self) -> bytes:
        """Return the body of the next value.

        Raises:
            LocalProtocolError: the space is not stated.
        """
        if not self._ahead:
            if not self._values:
                return AbstractType(*self._space.sample(self._generator)).body
            self._count, self._next = self._next, min(2 * self._next, self._values)
            self._before = self._generator.bit_generator.state
            self._ahead = self._bodies(self._numbers(self._count))
        return self._ahead.pop()

    def settle(self) -> np.random.Generator:
        """Return the generator, in its state after the values drawn so far."""
        if self._ahead:
            self._generator.bit_generator.state = self._before
            self._numbers(self._count - len(self._ahead))
            self._ahead = []
        self._next = 1
        return self._generator

    def _numbers(self, values: int) -> npt.NDArray[np.int64]:
        """Draw the numbers of `values` values, shape (values, ints + words of the chars)."""
        size = values, len(self._lows)
        return self._generator.integers(self._lows, self._highs, size, endpoint=True)

    def _bodies(self, numbers: npt.NDArray[np.int64]) -> list[bytes]:
        """Return values as bodies, the last one first."""
        ints, chars = numbers[:, : self._ints], numbers[:, self._ints :]
        prefix = AbstractType(ints[0], (), bytes(self._chars)).body[:PREFIX_SIZE]
        parts = (
            np.tile(np.frombuffer(prefix, np.uint8), (len(numbers), 1)),
            ints.astype("<i4", "C").view(np.uint8),
            chars.astype("<u4", "C").view(np.uint8)[:, : self._chars],
        )
        rows = np.concatenate(parts, axis=1)
        return [row.tobytes() for row in rows[::-1]]
