"""Actors other than Mario: how they are created, and how they move in a tick."""

from __future__ import annotations

from typing import Final

import numpy as np

from env_server.mario.sim.blocks import FLUNG_TICKS
from env_server.mario.sim.motion import move_sideways, move_vertically
from env_server.mario.sim.state import (
    FIREBALL,
    GREEN_KOOPA,
    MUSHROOM,
    PLANT,
    SHELL,
    SPAWN_KIND,
    SPAWN_WINGED,
    Actor,
    LevelMap,
    World,
    add_actor,
)
from glue.compiled.jit import jit

_ZERO: Final = np.float32(0)
_ONE: Final = np.float32(1)
_TWO: Final = np.float32(2)
_FRICTION: Final = np.float32(0.89)
_WALK: Final = np.float32(1.75)
_WALK_DAMPING: Final = np.float32(0.85)
_WALK_GRAVITY: Final = np.float32(2)
_WING_DAMPING: Final = np.float32(0.95)
_WING_GRAVITY: Final = np.float32(0.6)
_HOP: Final = np.float32(-10)
_DROP: Final = np.float32(-5)
_ROLL: Final = np.float32(11)
_FIREBALL_SPEED: Final = np.float32(8)
_PLANT_RISE: Final = np.float32(-8)
_PLANT_GRAVITY: Final = np.float32(0.1)
_PLANT_WAIT: Final = 40
_LONG: Final = 2**15 - 1
_PLANT_SHY: Final = 24
_RISE: Final = 9

# These dampings are double precision in the original, the others single.
_FLUNG_DAMPING: Final = 0.95
_PLANT_DAMPING: Final = 0.9
_FIREBALL_GRAVITY: Final = 1.5


@jit
def update_sprite(world: World, level: LevelMap, actor: Actor) -> None:
    """Move an actor other than Mario by one tick."""
    actor.old_x = actor.x
    actor.old_y = actor.y
    if actor.kind < PLANT:
        _update_walker(world, level, actor)
    elif actor.kind == PLANT:
        _update_plant(world, actor)
    elif actor.kind == SHELL:
        _update_shell(world, level, actor)
    elif actor.kind == FIREBALL:
        _update_fireball(world, level, actor)
    elif actor.age < _RISE:
        actor.age += 1
        actor.y -= _ONE
    elif actor.kind == MUSHROOM:
        _walk(world, level, actor)


@jit
def add_enemy(world: World, level: LevelMap, column: int, row: int, facing: int) -> None:
    """Create the enemy of a cell's spawn point."""
    spawn = int(level.spawns[column, row])
    kind = spawn & SPAWN_KIND
    if kind == PLANT:
        x = np.float32(16 * column + 15)
        actor = add_actor(world, kind, x, np.float32(16 * row + 23), 1, 12)
        actor.vy = _PLANT_RISE
    else:
        x = np.float32(16 * column + 8)
        height = 24 if kind <= GREEN_KOOPA else 12
        actor = add_actor(world, kind, x, np.float32(16 * row + 15), facing, height)
        actor.winged = spawn & SPAWN_WINGED != 0
    actor.column = column
    actor.row = row
    if kind == PLANT:
        for _ in range(4):  # it rises at once
            _update_plant(world, actor)
    update_sprite(world, level, actor)


@jit
def add_shell(world: World, level: LevelMap, x: np.float32, y: np.float32) -> None:
    """Create the shell of a koopa."""
    shell = add_actor(world, SHELL, x, y, 0, 12)
    shell.vy = _DROP
    update_sprite(world, level, shell)


@jit
def add_fireball(world: World, level: LevelMap, x: np.float32, y: np.float32, facing: int) -> None:
    """Throw a fireball."""
    fireball = add_actor(world, FIREBALL, x, y, facing, 8)
    fireball.vy = np.float32(4)
    update_sprite(world, level, fireball)


@jit
def drop(actor: Actor, vx: int) -> None:
    """Let a shell or fireball fall out of the world."""
    actor.vx = np.float32(vx)
    actor.vy = _DROP
    actor.dead_timer = FLUNG_TICKS


@jit
def _turn(actor: Actor) -> None:
    """Face the direction of the last tick's motion."""
    if actor.vx > _TWO:
        actor.facing = 1
    if actor.vx < -_TWO:
        actor.facing = -1


@jit
def _walk(world: World, level: LevelMap, actor: Actor) -> None:
    """Walk, and turn at walls."""
    _turn(actor)
    actor.vx = np.float32(actor.facing) * _WALK
    if move_sideways(world, level, actor, actor.vx):
        actor.facing = -actor.facing
    actor.grounded = False
    move_vertically(world, level, actor, actor.vy)
    actor.vy *= _WING_DAMPING if actor.winged else _WALK_DAMPING
    actor.vx *= _FRICTION
    if not actor.grounded:
        actor.vy += _WING_GRAVITY if actor.winged else _WALK_GRAVITY
    elif actor.winged:
        actor.vy = _HOP


@jit
def _update_walker(world: World, level: LevelMap, actor: Actor) -> None:
    if actor.dead_timer == 0:
        _walk(world, level, actor)
    else:
        _age_dead(actor)
        if actor.flung:
            _fly_off(actor)


@jit
def _update_plant(world: World, actor: Actor) -> None:
    if actor.dead_timer > 0:
        _age_dead(actor)
        _fly_off(actor)
        return
    base = np.float32(16 * int(actor.row) + 24)
    if actor.y >= base:
        actor.y = base
        actor.age += actor.age < _LONG
        gap = int(abs(world.actors[0].x - actor.x))
        actor.vy = _PLANT_RISE if actor.age > _PLANT_WAIT and gap > _PLANT_SHY else _ZERO
    else:
        actor.age = 0
    actor.y += actor.vy
    actor.vy = np.float32(np.float64(actor.vy) * _PLANT_DAMPING)
    actor.vy += _PLANT_GRAVITY


@jit
def _update_shell(world: World, level: LevelMap, actor: Actor) -> None:
    if actor.carried:
        actor.queued = True
    elif actor.dead_timer > 0:
        _age_dead(actor)
        _fly_off(actor)
    else:
        _turn(actor)
        actor.vx = np.float32(actor.facing) * _ROLL
        actor.queued = actor.facing != 0
        if move_sideways(world, level, actor, actor.vx):
            actor.facing = -actor.facing
        actor.grounded = False
        move_vertically(world, level, actor, actor.vy)
        actor.vy *= _WALK_DAMPING
        actor.vx *= _FRICTION
        if not actor.grounded:
            actor.vy += _WALK_GRAVITY


@jit
def _update_fireball(world: World, level: LevelMap, actor: Actor) -> None:
    if actor.dead_timer > 0:
        actor.leaving = True
        return
    _turn(actor)
    actor.vx = np.float32(actor.facing) * _FIREBALL_SPEED
    actor.queued = True
    if move_sideways(world, level, actor, actor.vx):
        actor.dead = True
        drop(actor, -2 * actor.facing)
    actor.grounded = False
    move_vertically(world, level, actor, actor.vy)
    if actor.grounded:
        actor.vy = _HOP
    actor.vy *= _WING_DAMPING
    actor.vx *= _FRICTION
    if not actor.grounded:
        actor.vy = np.float32(np.float64(actor.vy) + _FIREBALL_GRAVITY)


@jit
def _age_dead(actor: Actor) -> None:
    actor.dead_timer -= 1
    if actor.dead_timer == 0:
        actor.dead_timer = 1
        actor.leaving = True


@jit
def _fly_off(actor: Actor) -> None:
    actor.x += actor.vx
    actor.y += actor.vy
    actor.vy = np.float32(np.float64(actor.vy) * _FLUNG_DAMPING)
    actor.vy += _ONE
