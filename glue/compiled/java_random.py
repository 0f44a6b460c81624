"""Java's generator java.util.Random; the caller keeps its 48 bits of state.

The state is an array of one int64, so that drawing can advance it.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from glue.compiled.jit import entry, jit

State = npt.NDArray[np.int64]

_MULTIPLIER: Final = 0x5DEECE66D
_INCREMENT: Final = 11
MASK: Final = (1 << 48) - 1
"""Mask of the 48 bits that java.util.Random uses of a state or seed."""
_HALF: Final = (1 << 24) - 1
_HIGH: Final = _MULTIPLIER >> 24
_LOW: Final = _MULTIPLIER & _HALF


@entry
def seeded(seed: int) -> State:
    """Return the state that Java gives the 64-bit `seed`."""
    state = np.empty(1, np.int64)
    state[0] = (seed ^ _MULTIPLIER) & MASK
    return state


@jit
def draw(state: State, bound: int) -> int:
    """Return a number from 0 to `bound` - 1, each equally likely; `bound` is at least 1."""
    if bound & -bound == bound:
        return (int(bound) * _next(state, 31)) >> 31  # int: if not compiled, a world's field has 32 bits
    while True:
        bits = _next(state, 31)
        value = bits % bound
        if bits - value + bound - 1 < 1 << 31:  # else the last, incomplete run of numbers: draw again
            return value


@entry
def draw_double(state: State) -> float:
    """Return a number from [0, 1), a multiple of 2**-53."""
    high = _next(state, 26)
    return float((high << 27) + _next(state, 27)) * 2.0**-53


@jit
def _next(state: State, bits: int) -> int:
    """Advance the state; return its upper `bits` bits."""
    # In halves of 24 bits, since the full product would not fit 64.
    high = int(state[0]) >> 24
    low = int(state[0]) & _HALF
    product = (((high * _LOW + low * _HIGH) & _HALF) << 24) + low * _LOW + _INCREMENT
    state[0] = product & MASK
    return int(state[0]) >> (48 - bits)
