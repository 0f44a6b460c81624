"""Gymnasium spaces for recorded values, including values whose counts the task spec does not state."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Final

import numpy as np
from gymnasium import spaces

from glue.gym.codec import Codec
from glue.types import AbstractType, arrays_of

Counts = tuple[int, int, int]
"""Numbers of ints, doubles and chars."""

Conversion = tuple[spaces.Space[Any], Callable[[AbstractType], Any]]
"""A space, and a function that turns an observation or action into a value of the space."""

_INT32: Final = np.iinfo(np.int32)


def stated(space: spaces.Space[Any]) -> Conversion:
    """Return the conversion for the space of a task spec."""
    return space, Codec(space).unpack


def padded(most: Counts) -> Conversion:
    """Return the conversion to zero-padded arrays and `counts`, the numbers of values before padding.

    Args:
        most: the largest counts; a kind whose count is 0 is left out.
    """
    boxes = {
        "ints": spaces.Box(_INT32.min, _INT32.max, (most[0],), np.int32),
        "doubles": spaces.Box(-np.inf, np.inf, (most[1],), np.float64),
        "chars": spaces.Box(0, 255, (most[2],), np.uint8),
    }
    found = {name: box for (name, box), count in zip(boxes.items(), most, strict=True) if count}
    found["counts"] = spaces.Box(0, _INT32.max, (3,), np.int32)

    def convert(value: AbstractType) -> dict[str, Any]:
        numbers = {**arrays_of(value), "counts": np.array(value.counts, np.int32)}
        return {
            name: np.concatenate([numbers[name], np.zeros(box.shape[0] - len(numbers[name]), box.dtype)])
            for name, box in found.items()
        }

    return spaces.Dict(found), convert


def stacked(values: list[Any]) -> Any:
    """Return values of a space, one for each step, as one value of arrays whose first axis is the step."""
    first = values[0]
    if isinstance(first, dict):
        return {name: stacked([value[name] for value in values]) for name in first}
    if isinstance(first, tuple):
        return tuple(stacked(list(parts)) for parts in zip(*values, strict=True))
    return np.stack(values)
