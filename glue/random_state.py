"""A generator's state as bytes, so that a saved player continues with the same random numbers."""

from __future__ import annotations

import struct
from typing import Final

import numpy as np

from glue.errors import SaveError

_LAYOUT: Final = struct.Struct("<16s16sII")

GENERATOR_SIZE: Final = _LAYOUT.size
"""Bytes of a saved generator: state and increment of 128 bits, a flag, and a spare 32-bit number."""


def save_generator(generator: np.random.Generator) -> bytes:
    """Return the state of a generator made by `np.random.default_rng` (PCG64)."""
    state = generator.bit_generator.state
    inner = state["state"]
    return _LAYOUT.pack(
        inner["state"].to_bytes(16, "little"),
        inner["inc"].to_bytes(16, "little"),
        state["has_uint32"],
        state["uinteger"],
    )


def load_generator(data: bytes) -> np.random.Generator:
    """Return the generator that `save_generator` saved.

    Raises:
        SaveError: `data` does not have GENERATOR_SIZE bytes, or is not the state of a generator.
    """
    if len(data) != GENERATOR_SIZE:
        raise SaveError(f"a saved generator has {GENERATOR_SIZE} bytes; received {len(data)}")
    state, increment, has_uint32, uinteger = _LAYOUT.unpack(data)
    if has_uint32 > 1 or increment[0] % 2 == 0:
        raise SaveError("a saved generator is damaged: its state is not one of PCG64")
    bits = np.random.PCG64()
    bits.state = {
        "bit_generator": "PCG64",
        "state": {"state": int.from_bytes(state, "little"), "inc": int.from_bytes(increment, "little")},
        "has_uint32": has_uint32,
        "uinteger": uinteger,
    }
    return np.random.Generator(bits)
