"""The effects of hitting a block, including those on actors that stand on it."""

from __future__ import annotations

from typing import Final

import numpy as np

from env_server.mario.sim import tiles as tile
from env_server.mario.sim.state import FIREBALL, FLOWER, MUSHROOM, PLANT, Actor, LevelMap, World, add_actor
from env_server.mario.sim.tiles import behavior_at, change_tile, tile_of
from glue.compiled.jit import jit

FLUNG_TICKS: Final = 100
_FLING: Final = np.float32(-5)
_JOLT: Final = np.float32(-10)


@jit
def take_coin(world: World, level: LevelMap, column: int, row: int) -> None:
    """Take the loose coin of a cell, if there is one."""
    if behavior_at(world, level, column, row) & tile.PICKUP:
        world.coins += 1
        change_tile(world, level, column, row)


@jit
def hit_block(world: World, level: LevelMap, column: int, row: int, can_break: bool) -> None:
    """Hit a cell from below or from the side: it yields its content, or breaks."""
    behavior = behavior_at(world, level, column, row)
    if behavior & tile.BUMPABLE:
        _jolt(world, level, column, row - 1)
        change_tile(world, level, column, row)
        if behavior & tile.SPECIAL:
            _add_item(world, column, row)
        else:
            world.coins += 1
    if behavior & tile.BREAKABLE:
        _jolt(world, level, column, row - 1)
        if can_break:
            change_tile(world, level, column, row)


@jit
def fling(world: World, enemy: Actor, vx: int) -> None:
    """Kill an enemy so that it flies off."""
    enemy.vx = np.float32(vx)
    enemy.vy = _FLING
    enemy.flung = True
    enemy.winged = False
    enemy.dead_timer = FLUNG_TICKS
    mark_spawn_dead(world, enemy)


@jit
def mark_spawn_dead(world: World, enemy: Actor) -> None:
    """Keep the spawn point of `enemy` from making another one."""
    world.dead[enemy.column] |= 1 << int(enemy.row)


@jit
def _add_item(world: World, column: int, row: int) -> None:
    kind = FLOWER if world.large else MUSHROOM
    x = np.float32(16 * column + 8)
    item = add_actor(world, kind, x, np.float32(16 * row + 8), 1, 12)
    # Its first update, as for every added actor: items rise.
    item.y -= np.float32(1)
    item.age = 1


@jit
def _jolt(world: World, level: LevelMap, column: int, row: int) -> None:
    """Shake the cell above a block: a coin there is taken, and actors standing there react."""
    take_coin(world, level, column, row)
    away = -world.actors[0].facing
    for i in range(world.listed):
        actor = world.actors[world.order[i]]
        if actor.kind in (FLOWER, FIREBALL) or not _stands_on(actor, column, row):
            continue
        if actor.kind <= PLANT:
            if actor.dead_timer == 0:
                fling(world, actor, 2 * away)
        else:
            actor.facing = away
            actor.vy = _JOLT


@jit
def _stands_on(actor: Actor, column: int, row: int) -> bool:
    width = np.float32(2 if actor.kind == PLANT else 4)
    return bool(
        actor.x + width > 16 * column
        and actor.x - width < 16 * column + 16
        and tile_of(actor.y - np.float32(1)) == row
    )
