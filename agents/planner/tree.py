"""The memory of a search: nodes, a heap of those to expand, and a table of the states met."""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from glue.compiled.jit import jit
from glue.compiled.records import Array, Int, Real, layout


class Node:
    """A state that a plan leads to."""

    key: Real  # the heap's order: the lowest is expanded first
    parent: Int  # -1 for the root
    action: Int
    depth: Int  # steps from the root
    x: Real  # pixels
    rank: Real  # merit as the end of a plan: the lowest is best


NODE: Final = layout(Node)
DESCRIBED: Final = 10
FRICTION: Final = 0.89  # share of Mario's speed that is kept in a tick
_TICKS: Final = 5.0  # of a step
_GRAIN: Final = 4  # pixels
_FNV: Final = np.uint64(1099511628211)


@jit
def push(nodes: Array, heap: npt.NDArray[np.int64], size: int, node: int) -> int:
    """Put a node on the heap of `size` nodes; return the new size."""
    at = size
    while at > 0:
        above = (at - 1) // 2
        if nodes[heap[above]].key <= nodes[node].key:
            break
        heap[at] = heap[above]
        at = above
    heap[at] = node
    return size + 1


@jit
def pop(nodes: Array, heap: npt.NDArray[np.int64], size: int) -> int:
    """Take the lowest node off the heap of `size` nodes and return it; the heap then has one node fewer."""
    lowest = heap[0]
    heap[0] = heap[size - 1]
    sink(nodes, heap, size - 1)
    return int(lowest)


@jit
def sink(nodes: Array, heap: npt.NDArray[np.int64], size: int) -> None:
    """Restore the order of the heap of `size` nodes, whose first may be too high."""
    first = heap[0]
    at = 0
    while True:
        below = 2 * at + 1
        if below >= size:
            break
        if below + 1 < size and nodes[heap[below + 1]].key < nodes[heap[below]].key:
            below += 1
        if nodes[heap[below]].key >= nodes[first].key:
            break
        heap[at] = heap[below]
        at = below
    heap[at] = first


@jit
def describe(world: Any, numbers: npt.NDArray[np.int64]) -> None:
    """Write the first `DESCRIBED` of the numbers by which `meet` distinguishes states."""
    mario = world.actors[0]
    numbers[0] = int(mario.x) // _GRAIN
    numbers[1] = int(mario.y) // _GRAIN
    numbers[2] = int(np.floor(mario.vx))
    numbers[3] = int(np.floor(mario.vy / np.float32(2)))
    numbers[4] = world.jump_count
    numbers[5] = 4 * world.large + 2 * world.may_jump + mario.grounded
    numbers[6] = world.coins
    numbers[7] = world.kills
    numbers[8] = world.safe_timer > 0
    numbers[9] = world.carrying > 0


@jit
def stride(world: Any) -> float:
    """Return the distance that Mario runs in a step, in pixels."""
    return float(_TICKS * world.speed_run / (1.0 - FRICTION))


@jit
def forget(table: npt.NDArray[np.uint64]) -> None:
    """Empty the table."""
    table[:] = 0


@jit
def meet(table: npt.NDArray[np.uint64], numbers: npt.NDArray[np.int64]) -> bool:
    """Add a state, given by whole numbers, to the table; return whether it was there already."""
    hashed = np.uint64(14695981039346656037)
    for i in range(len(numbers)):
        hashed = (hashed ^ np.uint64(numbers[i])) * _FNV
        hashed ^= hashed >> np.uint64(29)
    hashed |= np.uint64(1)
    mask = len(table) - 1
    at = int(hashed >> np.uint64(20)) & mask
    while table[at] != 0:
        if table[at] == hashed:
            return True
        at = (at + 1) & mask
    table[at] = hashed
    return False
