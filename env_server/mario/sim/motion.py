"""Motion and collision with tiles: sideways, then vertically, in substeps of at most 8 pixels.

A body tests the grid with a few probe points, but never the cell that its feet are in. For Mario and for
shells a probe has effects of its own, such as taking a coin, and the next probe sees the changed tile.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from env_server.mario.sim.blocks import hit_block, take_coin
from env_server.mario.sim.state import MARIO, RED_KOOPA, SHELL, Actor, LevelMap, World
from env_server.mario.sim.tiles import CEILINGS, COINS, FLOORS, WALLS, cells_at, row_bit, tile_of
from glue.compiled.jit import jit

_ZERO: Final = np.float32(0)
_ONE: Final = np.float32(1)
_TILE: Final = np.float32(16)
_SUBSTEP: Final = np.float32(8)
_HALF_WIDTH: Final = 4  # of every actor that collides with tiles
_REACH: Final = np.float32(_HALF_WIDTH)


@jit
def move_sideways(world: World, level: LevelMap, actor: Actor, amount: np.float32) -> bool:
    """Move by `amount` pixels or up to an obstacle, which clears `vx`; return whether there was one."""
    head = tile_of(actor.y - np.float32(actor.height))
    middle = tile_of(actor.y - np.float32(actor.height // 2))
    feet = tile_of(actor.y)
    others = (0 if head == feet else row_bit(head)) | (0 if middle == feet else row_bit(middle))
    side = 1 if amount > _ZERO else -1
    reach = np.float32(side * _HALF_WIDTH)
    while amount != _ZERO:
        dx = _substep(amount)
        column = tile_of(actor.x + dx + reach)
        is_own = column == tile_of(actor.x)
        probes = others if is_own else others | row_bit(feet)
        cells = cells_at(world, level, column)
        walls = cells & probes * WALLS
        blocked = walls != 0
        if actor.kind == MARIO:
            world.wall_slide = not is_own and head >= 0 and walls == probes * WALLS
            if cells & probes * COINS:
                for row in (head, middle, feet):
                    if not (is_own and row == feet):
                        take_coin(world, level, column, row)
        elif actor.kind == SHELL and blocked:
            for row in (head, middle, feet):
                if walls & row_bit(row) * WALLS and not (is_own and row == feet):
                    hit_block(world, level, column, row, True)
        elif actor.kind == RED_KOOPA and actor.grounded:  # it turns around at a cliff
            below = int(actor.y / _TILE + _ONE)
            blocked = blocked or cells & row_bit(below) * FLOORS == 0
        if blocked:
            if side < 0:
                actor.x = np.float32(int((actor.x + reach) / _TILE) * 16 + _HALF_WIDTH)
            else:
                actor.x = np.float32(int((actor.x + reach) / _TILE + _ONE) * 16 - _HALF_WIDTH - 1)
            actor.vx = _ZERO
            return True
        actor.x += dx
        amount -= dx
    return False


@jit
def move_vertically(world: World, level: LevelMap, actor: Actor, amount: np.float32) -> None:
    """Move by `amount` pixels or up to an obstacle: a ceiling clears `vy`, a floor grounds the actor.

    Landing does not clear `vy`: the remaining speed keeps a standing actor grounded.
    """
    falls = amount > _ZERO
    blocked = False
    while amount != _ZERO and not blocked:
        dy = _substep(amount)
        blocked = _substep_down(world, level, actor, dy) if falls else _substep_up(world, level, actor, dy)
        amount -= dy


@jit
def _substep(amount: np.float32) -> np.float32:
    if amount > _SUBSTEP:
        return _SUBSTEP
    return -_SUBSTEP if amount < -_SUBSTEP else amount


@jit
def _substep_up(world: World, level: LevelMap, actor: Actor, dy: np.float32) -> bool:
    height = np.float32(actor.height)
    row = tile_of(actor.y + dy - height)
    is_own_row = row == tile_of(actor.y)
    own_column = tile_of(actor.x)
    for x in (actor.x, actor.x - _REACH, actor.x + _REACH):
        column = tile_of(x)
        if is_own_row and column == own_column:
            continue
        cells = cells_at(world, level, column)
        if actor.kind == MARIO and cells & row_bit(row) * COINS:
            take_coin(world, level, column, row)
        if cells & row_bit(row) * CEILINGS:
            if actor.kind == MARIO:
                world.jump_count = 0
                hit_block(world, level, column, row, world.large)
            actor.y = np.float32(int((actor.y - height) / _TILE) * 16 + int(actor.height))
            actor.vy = _ZERO
            return True
    actor.y += dy
    return False


@jit
def _substep_down(world: World, level: LevelMap, actor: Actor, dy: np.float32) -> bool:
    left = tile_of(actor.x - _REACH)
    right = tile_of(actor.x + _REACH)
    feet = tile_of(actor.y + dy)
    below = tile_of(actor.y + dy + _ONE)
    own_column = tile_of(actor.x)
    own_row = tile_of(actor.y)
    at_feet = row_bit(feet) * WALLS
    at_ground = row_bit(below) * FLOORS
    probes = at_feet | at_ground
    own_probes = (0 if feet == own_row else at_feet) | (0 if below == own_row else at_ground)
    left_cells = cells_at(world, level, left)
    right_cells = cells_at(world, level, right)
    blocked = (
        left_cells & (own_probes if left == own_column else probes)
        | right_cells & (own_probes if right == own_column else probes)
    ) != 0
    if actor.kind == MARIO and (left_cells | right_cells) & (row_bit(feet) | row_bit(below)) * COINS:
        blocked = _fall_onto_coins(world, level, actor, dy)
    if not blocked:
        actor.y += dy
        return False
    start = actor.y - _ONE if actor.kind == MARIO else actor.y
    actor.y = np.float32(int(start / _TILE + _ONE) * 16 - 1)
    actor.grounded = True
    return True


@jit
def _fall_onto_coins(world: World, level: LevelMap, mario: Actor, dy: np.float32) -> bool:
    """Take the coins that Mario's probes meet up to the first blocked probe; return whether there is one."""
    for probe in range(4):
        column = tile_of(mario.x - _REACH if probe % 2 == 0 else mario.x + _REACH)
        row = tile_of(mario.y + dy if probe < 2 else mario.y + dy + _ONE)
        if column == tile_of(mario.x) and row == tile_of(mario.y):
            continue
        take_coin(world, level, column, row)
        if cells_at(world, level, column) & row_bit(row) * (WALLS if probe < 2 else FLOORS):
            return True
    return False
