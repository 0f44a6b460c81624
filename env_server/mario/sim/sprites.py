"""Actors other than Mario: how they are created, how they move in a tick, and collisions: of Mario with them,
and of shells and fireballs with them.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from env_server.mario.sim.blocks import FLUNG_TICKS, fling, mark_spawn_dead
from env_server.mario.sim.motion import move_sideways, move_vertically
from env_server.mario.sim.physics import bounce, grow, hurt, is_untouchable
from env_server.mario.sim.state import (
    FIREBALL,
    FLOWER,
    GREEN_KOOPA,
    MUSHROOM,
    PLANT,
    SHELL,
    SPAWN_KIND,
    SPAWN_WINGED,
    SPIKY,
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


_STOMPED_TICKS: Final = 10
_REACH: Final = 16  # pixels


@jit
def touch_all(world: World, level: LevelMap) -> None:
    """Test all pairs that matter, in the original's three passes."""
    for i in range(world.listed):
        _touch_mario(world, level, world.actors[world.order[i]], world.order[i])
    for i in range(world.listed):
        shell = world.actors[world.order[i]]
        if shell.queued and shell.kind == SHELL:
            shell.queued = False
            _roll_over_others(world, shell, world.order[i])
    for i in range(world.listed):
        _burn_others(world, world.actors[world.order[i]])
    for i in range(world.added):  # a shell thrown in this tick has been tested already
        _burn_others(world, world.actors[world.waiting[i]])


@jit
def _overlap(dx: np.float32, dy: np.float32, reach: int, height: int, other_height: int) -> bool:
    """Return whether a body touches another, (dx, dy) away and `other_height` tall."""
    return bool(-reach < dx < reach and -height < dy < other_height)


@jit
def _is_stomp(world: World, mario: Actor, dy: np.float32) -> bool:
    return bool(mario.vy > 0 and dy <= 0 and not (mario.grounded and world.was_grounded))


@jit
def _touch_mario(world: World, level: LevelMap, actor: Actor, slot: int) -> None:
    mario = world.actors[0]
    dx = mario.x - actor.x
    dy = mario.y - actor.y
    if actor.kind <= PLANT:
        reach = 8 if actor.kind == PLANT else 12
        if actor.dead_timer == 0 and _overlap(dx, dy, reach, actor.height, mario.height):
            _touch_enemy(world, level, mario, actor, dy)
    elif actor.kind == SHELL:
        untouched = actor.carried or actor.dead or actor.dead_timer > 0
        if not untouched and _overlap(dx, dy, _REACH, actor.height, mario.height):
            _touch_shell(world, level, mario, actor, slot, dy)
    elif actor.kind in (MUSHROOM, FLOWER) and _overlap(dx, dy, _REACH, actor.height, mario.height):
        grow(world, actor.kind == FLOWER)
        actor.leaving = True


@jit
def _touch_enemy(world: World, level: LevelMap, mario: Actor, enemy: Actor, dy: np.float32) -> None:
    if enemy.kind == SPIKY or not _is_stomp(world, mario, dy):
        hurt(world)
        return
    if not is_untouchable(world):
        if not enemy.winged:
            world.kills += 1
        bounce(world, level, enemy.y, enemy.height)
    # The enemy is affected even if the contact had no effect on Mario.
    if enemy.winged:
        enemy.winged = False
        enemy.vy = np.float32(0)
        return
    mark_spawn_dead(world, enemy)
    enemy.dead_timer = _STOMPED_TICKS
    if enemy.kind <= GREEN_KOOPA:
        add_shell(world, level, enemy.x, enemy.y)


@jit
def _touch_shell(
    world: World, level: LevelMap, mario: Actor, shell: Actor, slot: int, dy: np.float32
) -> None:
    rolling = shell.facing != 0
    stomp = _is_stomp(world, mario, dy)
    if rolling and not stomp:
        hurt(world)
        return
    if not is_untouchable(world):
        if world.button_run and not rolling:
            world.carrying = slot
            shell.carried = True
        elif stomp:
            bounce(world, level, shell.y, shell.height)
        else:
            world.safe_timer = 1
    if rolling:
        shell.vx = np.float32(0)
        shell.facing = 0
    else:
        shell.facing = mario.facing


@jit
def _roll_over_others(world: World, shell: Actor, slot: int) -> None:
    """Test a rolling or carried shell against the others."""
    for i in range(world.listed):
        if shell.dead:
            break
        if world.order[i] == slot:
            continue
        hit = _meet_shell(world, world.actors[world.order[i]], world.order[i], shell, slot)
        if hit and world.carrying == slot and not shell.dead:
            world.carrying = 0
            _kill_shell(shell)


@jit
def _meet_shell(world: World, actor: Actor, slot: int, shell: Actor, shell_slot: int) -> bool:
    """Let a shell run into an actor; return whether it hit."""
    if actor.dead_timer > 0 or not (actor.kind <= PLANT or actor.kind == SHELL):
        return False
    if not _overlap(shell.x - actor.x, shell.y - actor.y, _REACH, actor.height, shell.height):
        return False
    if actor.kind <= PLANT:
        fling(world, actor, 2 * shell.facing)
        world.kills += 1
    else:
        if world.carrying in (slot, shell_slot):
            world.carrying = 0
        _kill_shell(actor)
        _kill_shell(shell)
    return True


@jit
def _kill_shell(shell: Actor) -> None:
    shell.dead = True
    shell.carried = False
    drop(shell, -2 * shell.facing)


@jit
def _burn_others(world: World, fireball: Actor) -> None:
    """Test a fireball against the others."""
    if not fireball.queued or fireball.kind != FIREBALL:
        return
    fireball.queued = False
    for i in range(world.listed):
        if fireball.dead:
            break
        if _meet_fireball(world, world.actors[world.order[i]], fireball):
            fireball.dead = True
            drop(fireball, -2 * fireball.facing)


@jit
def _meet_fireball(world: World, actor: Actor, fireball: Actor) -> bool:
    """Let a fireball run into an actor; return whether it hit."""
    if actor.dead_timer > 0 or not (actor.kind <= PLANT or actor.kind == SHELL):
        return False
    if not _overlap(fireball.x - actor.x, fireball.y - actor.y, _REACH, actor.height, fireball.height):
        return False
    if actor.kind == SHELL:
        if actor.facing == 0:
            drop(actor, 2 * fireball.facing)
    elif actor.kind != SPIKY:
        fling(world, actor, 2 * fireball.facing)
        world.kills += 1
    return True
