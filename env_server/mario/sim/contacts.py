"""Collisions: of Mario with other actors, and of shells and fireballs with other actors."""

from __future__ import annotations

from typing import Final

import numpy as np

from env_server.mario.sim.blocks import fling, mark_spawn_dead
from env_server.mario.sim.physics import bounce, grow, hurt, is_untouchable
from env_server.mario.sim.sprites import add_shell, drop
from env_server.mario.sim.state import (
    FIREBALL,
    FLOWER,
    GREEN_KOOPA,
    MUSHROOM,
    PLANT,
    SHELL,
    SPIKY,
    Actor,
    LevelMap,
    World,
)
from glue.compiled.jit import jit

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
