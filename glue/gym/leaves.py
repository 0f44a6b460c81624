"""The leaves of a space, which become runs of ints, doubles and chars."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from glue.errors import ConfigError

SpaceLike: TypeAlias = "spaces.Space[Any]"

INT, DOUBLE, CHAR = range(3)
"""The runs of an abstract type."""

INT32: Final = np.iinfo(np.int32)
FLOATS: Final = ("float16", "float32", "float64")
_MAX_DEPTH: Final = 16


class Leaf(NamedTuple):
    """A space without parts: its run, and the shape and type of its values."""

    space: SpaceLike
    run: int
    shape: tuple[int, ...]
    dtype: np.dtype[Any]

    @property
    def size(self) -> int:
        """Number of elements in the leaf."""
        return int(np.prod(self.shape, dtype=np.int64))


def leaves_of(space: SpaceLike, depth: int = 0) -> Iterator[Leaf]:
    """Yield the leaves of a space, those of a Dict in the order of its keys.

    Raises:
        ConfigError: the space is not of the kinds named at the top of `glue.gym.spaces`.
    """
    if depth > _MAX_DEPTH:
        raise ConfigError(f"a space nests more than {_MAX_DEPTH} deep")
    if isinstance(space, spaces.Dict):
        for key in space.spaces:
            if not isinstance(key, str):
                raise ConfigError(f"the keys of a Dict space are texts, not {key!r:.80}")
        for key in sorted(space.spaces):
            yield from leaves_of(space.spaces[key], depth + 1)
    elif isinstance(space, spaces.Tuple):
        for part in space.spaces:
            yield from leaves_of(part, depth + 1)
    elif isinstance(space, spaces.Discrete | spaces.MultiDiscrete | spaces.MultiBinary):
        leaf = Leaf(space, INT, tuple(space.shape), np.dtype(space.dtype))
        _check_ints(leaf)
        yield leaf
    elif isinstance(space, spaces.Box):
        yield _box_leaf(space)
    else:
        raise ConfigError(
            f"a task spec cannot describe {type(space).__name__}: only Discrete, MultiDiscrete, MultiBinary, "
            "Box, and Dict and Tuple of these"
        )


def ends_of(leaf: Leaf) -> tuple[npt.NDArray[Any], npt.NDArray[Any]]:
    """Return the smallest and the largest value of each number of a leaf, flat."""
    space = leaf.space
    if isinstance(space, spaces.Discrete):
        return np.array([space.start]), np.array([space.start + space.n - 1])
    if isinstance(space, spaces.MultiDiscrete):
        return space.start.reshape(-1), (space.start + space.nvec - 1).reshape(-1)
    if isinstance(space, spaces.MultiBinary):
        return np.zeros(leaf.size, np.int64), np.ones(leaf.size, np.int64)
    return space.low.reshape(-1), space.high.reshape(-1)


def _box_leaf(space: spaces.Box) -> Leaf:
    dtype = np.dtype(space.dtype)
    if dtype == np.uint8:
        return Leaf(space, CHAR, space.shape, dtype)
    if dtype.name in FLOATS:
        return Leaf(space, DOUBLE, space.shape, dtype)
    if dtype.kind in "iu":
        leaf = Leaf(space, INT, space.shape, dtype)
        _check_ints(leaf)
        return leaf
    raise ConfigError(f"a task spec cannot describe a Box of {dtype}: only of integers and floats of 64 bits")


def _check_ints(leaf: Leaf) -> None:
    low, high = ends_of(leaf)
    if leaf.size and (low.min() < INT32.min or high.max() > INT32.max):
        raise ConfigError(f"the ints of RL-Glue have 32 bits; {leaf.space!r:.200} needs more")
