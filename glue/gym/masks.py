"""Masks of the legal actions in Gymnasium's form, as the `sample` of an action space takes them.

Discrete        an array of int8, 1 for each legal value
MultiDiscrete   a tuple of such arrays, one for each number; in tuples if the space has several axes
MultiBinary     an array of the shape of the space: the only legal value, or 2 if both are
Box of ints     as MultiDiscrete, from the space's bounds on
Dict, Tuple     a dict or tuple of masks; None for a Box of floats or of uint8
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import suppress
from itertools import islice
from typing import Any

import numpy as np
import numpy.typing as npt
from gymnasium import spaces

from glue.errors import SimulatorError
from glue.gym.codec import INT, Codec, Leaf, SpaceLike, build, parts_of
from glue.taskspec import legal_values, mask_sizes
from glue.types import BoolArray, Observation


class MaskCodec:
    """Masks in Gymnasium's form as masks of observations, and back.

    Raises:
        ConfigError: the space is not of the kinds named at the top of `glue.gym.spaces`.
        TaskSpecError: an integer of the space has no bounds, or too many values for a mask.
    """

    def __init__(self, space: SpaceLike) -> None:
        self._space = space
        codec = Codec(space)
        self._leaves = codec.leaves
        self._sizes = mask_sizes(codec.ranges)

    def pack(self, mask: Any) -> npt.NDArray[np.bool_]:
        """Return a mask in Gymnasium's form as one of an observation.

        Raises:
            SimulatorError: it does not fit the space.
        """
        rows: list[npt.NDArray[Any]] = []
        with suppress(TypeError):  # not a sequence where one is expected
            for leaf, part in zip(self._leaves, parts_of(self._space, mask), strict=True):
                rows += map(np.asarray, _rows(leaf, part))
        if [row.shape for row in rows] == [(size,) for size in self._sizes]:
            bits = np.concatenate(rows)
            if bits.dtype == np.bool_ or ((bits == 0) | (bits == 1)).all():
                return bits.astype(np.bool_)
        raise SimulatorError(
            f"this is no mask of {self._space}, which has 1 for each legal value: {mask!r:.200}"
        )

    def unpack(self, observation: Observation) -> Any:
        """Return the mask of an observation in Gymnasium's form; every action is legal if it has none.

        Raises:
            RemoteProtocolError: it does not fit the space.
        """
        rows = iter(legal_values(observation, self._sizes))
        return build(self._space, (_leaf_mask(leaf, rows) for leaf in self._leaves))

    def flat(self, observation: Observation) -> BoolArray:
        """Return whether each value of each number of an action is legal, concatenated, shape (bits,).

        Raises:
            RemoteProtocolError: the mask of the observation does not fit the space.
        """
        return np.concatenate(legal_values(observation, self._sizes))


def _rows(leaf: Leaf, mask: Any) -> Iterator[Any]:
    """Yield from a mask in Gymnasium's form a row of truth values for each number of a leaf."""
    if leaf.run != INT:
        return
    if isinstance(leaf.space, spaces.Discrete):
        yield mask
    elif isinstance(leaf.space, spaces.MultiBinary):
        yield from ((one != 1, one != 0) for one in np.ravel(mask) if one in (0, 1, 2))
    else:
        yield from _flattened(mask, len(leaf.shape))


def _leaf_mask(leaf: Leaf, rows: Iterator[BoolArray]) -> Any:
    """Return the mask of a leaf in Gymnasium's form, from a row of truth values for each of its numbers."""
    if leaf.run != INT:
        return None
    mine = [row.astype(np.int8) for row in islice(rows, leaf.size)]
    if isinstance(leaf.space, spaces.MultiBinary):
        return np.array([2 if row.all() else row[1] for row in mine], np.int8).reshape(leaf.shape)
    return _nested(iter(mine), leaf.shape)


def _flattened(value: Any, depth: int) -> Iterator[Any]:
    if depth == 0:
        yield value
    else:
        for part in value:
            yield from _flattened(part, depth - 1)


def _nested(items: Iterator[Any], shape: tuple[int, ...]) -> Any:
    return tuple(_nested(items, shape[1:]) for _ in range(shape[0])) if shape else next(items)
