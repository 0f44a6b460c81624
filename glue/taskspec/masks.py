"""Masks of the legal actions, as an agent reads them.

sizes = mask_sizes(parse_task_spec(task_spec).actions)     # in agent_init
first, second = legal_values(observation, sizes)           # in each step, for an action of two ints
"""

from __future__ import annotations

from functools import lru_cache
from typing import Final

import numpy as np

from glue.errors import RemoteProtocolError, TaskSpecError
from glue.taskspec.space import Space
from glue.types import MAX_MASK_BITS, BoolArray, Observation

_FEW: Final = 32
"""Maximum size in bytes of a mask for which results are cached."""


def mask_sizes(actions: Space) -> tuple[int, ...]:
    """Return the number of values of each int of an action.

    Raises:
        TaskSpecError: an int has no minimum or no maximum, or there are more than `MAX_MASK_BITS` values.
    """
    sizes: list[int] = []
    bits = 0.0
    for repeat, range_ in actions.ints.runs:
        low, high = range_.ends
        size = high - low + 1
        bits += repeat * size
        if bits > MAX_MASK_BITS:
            raise TaskSpecError(
                f"there are masks for at most {MAX_MASK_BITS} values of all ints of an action together; the "
                f"task spec has INTS ({repeat} {range_.low} {range_.high})"
            )
        sizes += [int(size)] * repeat
    return tuple(sizes)


def legal_values(observation: Observation, sizes: tuple[int, ...]) -> tuple[BoolArray, ...]:
    """Return whether each value of each int of an action is legal; all are if the observation has no mask.

    Args:
        observation: what the agent receives.
        sizes: the result of `mask_sizes`.

    Returns:
        For each int a read-only array of shape (size,), whose first element is for the int's minimum.

    Raises:
        RemoteProtocolError: the mask does not fit the task spec, or leaves an int no legal value.
    """
    packed = observation.packed_mask
    read = _legal_values if len(packed) <= _FEW else _legal_values.__wrapped__
    return read(packed, sizes)


@lru_cache(maxsize=1024)
def _legal_values(packed: bytes, sizes: tuple[int, ...]) -> tuple[BoolArray, ...]:
    if why := mask_fault(packed, sizes):
        raise RemoteProtocolError(f"the environment sent a mask that does not fit its task spec: {why}")
    bits = sum(sizes)
    if packed:
        legal = np.unpackbits(np.frombuffer(packed, np.uint8), count=bits, bitorder="little").view(np.bool_)
    else:
        legal = np.ones(bits, np.bool_)
    legal.flags.writeable = False
    return tuple(np.split(legal, np.cumsum(sizes)[:-1])) if sizes else ()


def mask_fault(packed: bytes, sizes: tuple[int, ...]) -> str:
    """Return why a mask, as it crosses the wire, does not fit ints of `sizes` values; "" if it does."""
    if not packed:
        return ""
    find = _mask_fault if len(packed) <= _FEW else _mask_fault.__wrapped__
    return find(packed, sizes)


@lru_cache(maxsize=1024)
def _mask_fault(packed: bytes, sizes: tuple[int, ...]) -> str:
    bits = sum(sizes)
    values = int.from_bytes(packed, "little")
    size = (bits + 7) // 8
    if len(packed) != size or values.bit_length() > bits:
        right = f"{size} byte{'s' * (size != 1)} of mask, the spare bits zero"
        return f"{bits} values fill {right}, not 0x{packed[:16].hex()}"
    for number, count in enumerate(sizes):
        if not values & ((1 << count) - 1):
            return f"no value of int {number} is legal"
        values >>= count
    return ""
