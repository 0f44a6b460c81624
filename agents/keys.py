"""Keys of learned values: a feature is a row of integers, identified by a 64-bit hash of them.

With a hash, no kind of state needs its own encoding. The chance that a table of a million values has two
features under one key is 3e-8.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from agents.policy import mix
from glue.compiled.jit import jit

_STEP: Final = np.uint64(0x9E3779B97F4A7C15)


@jit
def feature(first: int) -> np.uint64:
    """Return the key of the row (first,)."""
    return mix(np.uint64(first) + _STEP)


@jit
def extend(key: np.uint64, number: int) -> np.uint64:
    """Return the key of the row of `key` with `number` appended."""
    return mix(key + np.uint64(number) + _STEP)
