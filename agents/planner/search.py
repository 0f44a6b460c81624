"""Weighted A* over the actions of Infinite Mario, with the model that its environment offers.

Its memory has nodes, a heap of those to expand, and a table of the states met; so has that of the search
for routes.
"""

from __future__ import annotations

from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from glue.compiled.jit import entry, jit
from glue.compiled.records import Array, Flag, Int, Real, layout
from glue.plugins.loading import find_model

model: Final = find_model("mario")
_step = model.step
_save = model.save
_load = model.load

BEFORE: Final = 24  # columns to the left of Mario that may change during a search
DESCRIBED: Final = 10
FRICTION: Final = 0.89  # share of Mario's speed that is kept in a tick
_TICKS: Final = 5.0  # of a step
_GRAIN: Final = 4  # pixels
_FNV: Final = np.uint64(1099511628211)

# Actions by number, 4 * (direction + 1) + 2 * jump + run, in the order in which they are tried.
_AHEAD: Final = np.array([11, 9, 10, 8, 6, 4, 2, 0], np.int64)
_ALL: Final = np.array([11, 9, 10, 8, 7, 6, 5, 4, 3, 2, 1, 0], np.int64)
_LEFT: Final = 0
STAY: Final = 4
_RIGHT: Final = 8
_BRAKING: Final = 8  # steps
_FAST: Final = np.float32(2)  # pixels a tick
_TRIED: Final = 48  # leaves that are tested for safety
_HURRY: Final = 0.3  # cost of a step in a hard search


class Node:
    """A state that a plan leads to."""

    key: Real  # the heap's order: the lowest is expanded first
    parent: Int  # -1 for the root
    action: Int
    depth: Int  # steps from the root
    x: Real  # pixels
    rank: Real  # merit as the end of a plan: the lowest is best


NODE: Final = layout(Node)


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


class Settings:
    """The settings of a search, and its results."""

    sims: Int  # model steps
    weight: Real  # of the remaining way
    coin: Real  # steps that a coin is worth
    kill: Real  # steps that a kill is worth
    size_cost: Real  # steps that being small rather than large costs
    end: Int  # the first column that has not been seen
    columns: Int  # number of columns that may change during the search, some to the left of Mario
    hard: Flag  # find any way at all: try all actions, and revisit no state at another time
    anytime: Flag  # use the whole budget
    used: Int  # result: model steps
    safe: Flag  # result: it is safe to stop where the plan ends


SETTINGS: Final = layout(Settings)


class Room(NamedTuple):
    """The memory of a search."""

    rows: npt.NDArray[np.uint8]  # the worlds of N nodes, shape (N, bytes)
    nodes: Array  # shape (N,)
    heap: npt.NDArray[np.int64]  # shape (N,)
    table: npt.NDArray[np.uint64]  # a power of two above 2 * N


def make_room(nodes: int, columns: int) -> Room:
    """Return the memory of a search of `nodes` nodes, in which `columns` columns may change."""
    return Room(
        np.zeros((nodes, model.row_size(columns)), np.uint8),
        np.zeros(nodes, NODE),
        np.zeros(nodes, np.int64),
        np.zeros(1 << (2 * nodes).bit_length(), np.uint64),
    )


@entry
def search(
    worlds: Array,
    levels: Array,
    scratch: Array,
    memory: npt.NDArray[np.uint8],
    rows: npt.NDArray[np.uint8],
    nodes: Array,
    heap: npt.NDArray[np.int64],
    table: npt.NDArray[np.uint64],
    settings: Array,
    plan: npt.NDArray[np.int64],
) -> int:
    """Plan from a belief; return the length of the new plan.

    Args:
        worlds, levels: the belief, shape (1,) each; it is not changed.
        scratch, memory: a world to step, shape (1,), and its bytes.
        rows, nodes, heap, table: see `Room`.
        settings: see `Settings`, shape (1,).
        plan: the last plan, ended by -1; receives the new plan.
    """
    how: Any = settings[0]
    level: Any = levels[0]
    world: Any = scratch[0]
    first = max(0, min(int(worlds[0].actors[0].x) // 16 - BEFORE, len(level.tiles) - how.columns))
    forget(table)
    # The root.
    memory[:] = worlds.view(np.uint8)
    earned = how.coin * world.coins + how.kill * world.kills
    large = int(world.large) + int(world.fire)
    root_x = float(world.actors[0].x)
    goal = min(16.0 * min(how.end, first + how.columns) - 8.0, 16.0 * level.exit_x + 1.0)
    _save(scratch, memory, rows[0], first, how.columns)
    nodes[0].parent = -1
    nodes[0].action = -1
    nodes[0].depth = 0
    nodes[0].x = root_x
    nodes[0].key = how.weight * (goal - root_x) / stride(worlds[0])
    nodes[0].rank = nodes[0].key
    count = 1
    size = push(nodes, heap, 0, 0)
    used = 0
    # The last plan goes in first.
    node = 0
    for i in range(len(plan)):
        if plan[i] < 0 or count >= len(nodes):
            break
        _load(scratch, memory, rows[node], first, how.columns)
        alive = _step(scratch, levels, plan[i])
        used += 1
        if not _add(world, level, alive, how, nodes, count, node, plan[i], earned, large, goal):
            break
        _save(scratch, memory, rows[count], first, how.columns)
        size = push(nodes, heap, size, count)
        node = count
        count += 1
    numbers = np.zeros(DESCRIBED + 1, np.int64)
    actions = _ALL if how.hard else _AHEAD
    best = -1
    how.safe = False
    while size > 0 and used < how.sims:
        node = pop(nodes, heap, size)
        size -= 1
        if nodes[node].x >= goal and node > 0:
            if nodes[node].x > 16.0 * level.exit_x:
                best = node
                how.safe = True
                break
            if not how.anytime:
                _load(scratch, memory, rows[node], first, how.columns)
                safe, steps = _is_safe(scratch, levels, 16.0 * how.end)
                used += steps
                if safe:
                    best = node
                    how.safe = True
                    break
            continue
        for k in range(len(actions)):
            if count >= len(nodes):
                break
            _load(scratch, memory, rows[node], first, how.columns)
            alive = _step(scratch, levels, actions[k])
            used += 1
            if not _add(world, level, alive, how, nodes, count, node, actions[k], earned, large, goal):
                continue
            if nodes[count].x < 16.0 * level.exit_x and _was_met(
                table, numbers, world, 0 if how.hard else nodes[count].depth // 2
            ):
                continue
            _save(scratch, memory, rows[count], first, how.columns)
            size = push(nodes, heap, size, count)
            count += 1
    if best < 0:
        best, steps = _best_leaf(scratch, levels, memory, rows, nodes, heap, count, first, how)
        used += steps
        how.safe = best > 0
    if best < 0:
        best = _longest_life(nodes, count)
    how.used = used
    length = nodes[best].depth
    if length >= len(plan):
        length = len(plan) - 1
    plan[length] = -1
    node = best
    while nodes[node].parent >= 0:
        if nodes[node].depth <= length:
            plan[nodes[node].depth - 1] = nodes[node].action
        node = nodes[node].parent
    return int(length)


@jit
def _add(
    world: Any,
    level: Any,
    alive: bool,
    how: Any,
    nodes: Array,
    count: int,
    parent: int,
    action: int,
    earned: float,
    large: int,
    goal: float,
) -> bool:
    """Fill in node `count` of a world that was stepped; return False if Mario is dead there."""
    won = world.win_timer > 0
    if (not alive and not won) or world.death_timer > 0:
        return False
    node = nodes[count]
    mario = world.actors[0]
    if not won and mario.y > np.float32(239):
        return False  # below the ground there is no way back
    node.parent = parent
    node.action = action
    node.depth = nodes[parent].depth + 1
    node.x = mario.x
    gained = how.coin * world.coins + how.kill * world.kills - earned
    lost = large - int(world.new_large if world.change_timer != 0 else world.large)
    lost -= int(world.new_fire if world.change_timer != 0 else world.fire)
    worth = (_HURRY if how.hard else 1.0) * node.depth - gained + how.size_cost * lost
    remaining = max(goal - node.x, 0.0) / stride(world)
    node.key = worth + how.weight * remaining
    node.rank = node.key
    return True


@jit
def _was_met(table: npt.NDArray[np.uint64], numbers: npt.NDArray[np.int64], world: Any, when: int) -> bool:
    describe(world, numbers)
    numbers[DESCRIBED] = when
    return meet(table, numbers)


@jit
def _is_safe(scratch: Any, levels: Any, end: float) -> tuple[bool, int]:
    """Brake and wait; return whether Mario then stands in a seen column, alive, and the number of steps."""
    world = scratch[0]
    for steps in range(_BRAKING):
        mario = world.actors[0]
        if world.win_timer > 0:
            return True, steps
        if mario.x > end:
            return False, steps
        action = STAY
        if mario.vx > _FAST:
            action = _LEFT
        elif mario.vx < -_FAST:
            action = _RIGHT
        alive = _step(scratch, levels, action)
        if (not alive and world.win_timer == 0) or world.death_timer > 0:
            return False, steps + 1
    mario = world.actors[0]
    return bool(mario.grounded and mario.x <= end), _BRAKING


@jit
def _best_leaf(
    scratch: Any,
    levels: Any,
    memory: npt.NDArray[np.uint8],
    rows: npt.NDArray[np.uint8],
    nodes: Array,
    heap: npt.NDArray[np.int64],
    count: int,
    first: int,
    how: Any,
) -> tuple[int, int]:
    """Return the best node at which stopping is safe, or -1, and the model steps used to find it."""
    used = 0
    for i in range(1, count):
        nodes[i].key = nodes[i].rank
    size = 0
    for i in range(1, count):
        size = push(nodes, heap, size, i)
    for _ in range(_TRIED):
        if size == 0:
            break
        node = pop(nodes, heap, size)
        size -= 1
        _load(scratch, memory, rows[node], first, how.columns)
        safe, steps = _is_safe(scratch, levels, 16.0 * how.end)
        used += steps
        if safe:
            return node, used
    return -1, used


@jit
def _longest_life(nodes: Array, count: int) -> int:
    """Return the deepest node; of several, the best."""
    best = 0
    for i in range(1, count):
        if nodes[i].depth > nodes[best].depth or (
            nodes[i].depth == nodes[best].depth and nodes[i].rank < nodes[best].rank
        ):
            best = i
    return best
