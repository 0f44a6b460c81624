"""Motion and collision with tiles: sideways, then vertically, in substeps of at most 8 pixels.

A body tests the grid with a few probe points. For Mario and for shells a probe has effects of its
own, such as taking a coin, and the next probe sees the changed tile.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from env_server.mario.sim.blocks import hit_block, take_coin
from env_server.mario.sim.state import MARIO, RED_KOOPA, SHELL, Actor, LevelMap, World
from env_server.mario.sim.tiles import PICKUP, behavior_at, solid, stops, tile_of
from glue.compiled.jit import jit

_ZERO: Final = np.float32(0)
_ONE: Final = np.float32(1)
_TILE: Final = np.float32(16)
_SUBSTEP: Final = np.float32(8)
_HALF_WIDTH: Final = 4  # of everything that meets tiles
_REACH: Final = np.float32(_HALF_WIDTH)


@jit
def move_sideways(world: World, level: LevelMap, actor: Actor, amount: np.float32) -> bool:
    """Move by `amount` pixels or up to an obstacle, which clears `vx`; return whether there was one."""
    while amount > _SUBSTEP:
        if _substep_sideways(world, level, actor, _SUBSTEP):
            return True
        amount -= _SUBSTEP
    while amount < -_SUBSTEP:
        if _substep_sideways(world, level, actor, -_SUBSTEP):
            return True
        amount += _SUBSTEP
    return amount != _ZERO and _substep_sideways(world, level, actor, amount)


@jit
def move_vertically(world: World, level: LevelMap, actor: Actor, amount: np.float32) -> None:
    """Move by `amount` pixels or up to an obstacle: a ceiling clears `vy`, a floor grounds the actor.

    Landing does not clear `vy`: what remains of it keeps a standing actor grounded.
    """
    while amount > _SUBSTEP:
        if _substep_down(world, level, actor, _SUBSTEP):
            return
        amount -= _SUBSTEP
    while amount < -_SUBSTEP:
        if _substep_up(world, level, actor, -_SUBSTEP):
            return
        amount += _SUBSTEP
    if amount > _ZERO:
        _substep_down(world, level, actor, amount)
    elif amount < _ZERO:
        _substep_up(world, level, actor, amount)


@jit
def _substep_sideways(world: World, level: LevelMap, actor: Actor, dx: np.float32) -> bool:
    side = 1 if dx > _ZERO else -1
    reach = np.float32(side * _HALF_WIDTH)
    front = actor.x + dx + reach
    # All three probes are always made, for their effects.
    head = _probe(world, level, actor, front, actor.y - np.float32(actor.height), _ZERO, dx)
    middle = _probe(world, level, actor, front, actor.y - np.float32(actor.height // 2), _ZERO, dx)
    feet = _probe(world, level, actor, front, actor.y, _ZERO, dx)
    if actor.kind == MARIO:
        world.wall_slide = head and middle and feet
    blocked = head or middle or feet
    if actor.kind == RED_KOOPA and actor.grounded:  # it turns around at a cliff
        below = int(actor.y / _TILE + _ONE)
        blocked = blocked or not solid(world, level, tile_of(front), below, _ONE)
    if not blocked:
        actor.x += dx
        return False
    if side < 0:
        actor.x = np.float32(int((actor.x + reach) / _TILE) * 16 + _HALF_WIDTH)
    else:
        actor.x = np.float32(int((actor.x + reach) / _TILE + _ONE) * 16 - _HALF_WIDTH - 1)
    actor.vx = _ZERO
    return True


@jit
def _substep_up(world: World, level: LevelMap, actor: Actor, dy: np.float32) -> bool:
    height = np.float32(actor.height)
    top = actor.y + dy - height
    blocked = (
        _probe(world, level, actor, actor.x, top, dy, _ZERO)
        or _probe(world, level, actor, actor.x - _REACH, top, dy, _ZERO)
        or _probe(world, level, actor, actor.x + _REACH, top, dy, _ZERO)
    )
    if not blocked:
        actor.y += dy
        return False
    actor.y = np.float32(int((actor.y - height) / _TILE) * 16 + int(actor.height))
    actor.vy = _ZERO
    if actor.kind == MARIO:
        world.jump_count = 0
    return True


@jit
def _substep_down(world: World, level: LevelMap, actor: Actor, dy: np.float32) -> bool:
    feet = actor.y + dy
    blocked = (
        _probe(world, level, actor, actor.x - _REACH, feet, _ZERO, _ZERO)
        or _probe(world, level, actor, actor.x + _REACH, feet, _ZERO, _ZERO)
        or _probe(world, level, actor, actor.x - _REACH, feet + _ONE, dy, _ZERO)
        or _probe(world, level, actor, actor.x + _REACH, feet + _ONE, dy, _ZERO)
    )
    if not blocked:
        actor.y += dy
        return False
    start = actor.y - _ONE if actor.kind == MARIO else actor.y
    actor.y = np.float32(int(start / _TILE + _ONE) * 16 - 1)
    actor.grounded = True
    return True


@jit
def _probe(
    world: World, level: LevelMap, actor: Actor, x: np.float32, y: np.float32, vy: np.float32, dx: np.float32
) -> bool:
    """Return whether the tile at (x, y) blocks, with the effects that the probe has.

    `vy` is the vertical motion that one-way tiles are asked about, `dx` the sideways part of the
    substep. The tile that the actor's feet are in never blocks.
    """
    column = tile_of(x)
    row = tile_of(y)
    if column == tile_of(actor.x) and row == tile_of(actor.y):
        return False
    behavior = behavior_at(world, level, column, row)
    blocks = stops(behavior, vy)
    if actor.kind == MARIO:
        if behavior & PICKUP:  # few are, and it would look the tile up again
            take_coin(world, level, column, row)
        if blocks and vy < _ZERO:
            hit_block(world, level, column, row, world.large)
    elif actor.kind == SHELL and blocks and dx != _ZERO:
        hit_block(world, level, column, row, True)
    return blocks
