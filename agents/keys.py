"""Keys of learned values: a feature is a row of whole numbers, known by a 64-bit hash of them.

Hashing spares every kind of state its own way to fit a key, and a table of a million values has two
features under one key with a chance of only 3e-8.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from agents.policy import mix
from glue.compiled.jit import jit

__all__ = ["extend", "feature"]

_STEP: Final = np.uint64(0x9E3779B97F4A7C15)


@jit
def feature(first: int) -> np.uint64:
    """Return the key of the row (first,)."""
    return mix(np.uint64(first) + _STEP)


@jit
def extend(key: np.uint64, number: int) -> np.uint64:
    """Return the key of the row that `key` stands for with `number` added at its end."""
    return mix(key + np.uint64(number) + _STEP)
