"""Mario: the effects of the buttons and of other actors on him."""

from __future__ import annotations

from typing import Final

import numpy as np

from env_server.mario.sim.motion import move_sideways, move_vertically
from env_server.mario.sim.sprites import add_fireball
from env_server.mario.sim.state import ROWS, Actor, LevelMap, World
from glue.compiled.jit import jit

_ZERO: Final = np.float32(0)
_TWO: Final = np.float32(2)
_HALF: Final = np.float32(0.5)
_FRICTION: Final = np.float32(0.89)
_GRAVITY: Final = np.float32(3)
_WALL_PUSH: Final = 6
_BOUNCE_VY: Final = np.float32(-1.9)
_BOUNCE_COUNT: Final = 8
_FIREBALLS: Final = 2
_HOLD_AHEAD: Final = 8
_HOLD_UP: Final = np.float32(2)
_BOTTOM: Final = np.float32(16 * ROWS + 16)
_CHANGE_TICKS: Final = 18
_SAFE_TICKS: Final = 32
_DEATH_PAUSE: Final = 11
_DEATH_LEAP: Final = np.float32(-15)


@jit
def update_mario(world: World, level: LevelMap) -> None:
    """Move Mario by one tick."""
    mario = world.actors[0]
    mario.old_x = mario.x
    mario.old_y = mario.y
    if world.win_timer > 0:
        world.win_timer += 1
        mario.vx = _ZERO
        mario.vy = _ZERO
    elif world.death_timer > 0:
        _fall_dead(world, mario)
    elif world.change_timer != 0:
        _change_size(world, mario)
    else:
        _walk_and_jump(world, level, mario)


@jit
def die(world: World) -> None:
    """Start Mario's death sequence."""
    world.frozen = True
    world.death_timer = 1


@jit
def is_untouchable(world: World) -> bool:
    """Return whether Mario is invulnerable now."""
    return world.death_timer > 0 or world.frozen


@jit
def hurt(world: World) -> None:
    """Hurt Mario: he loses fire if he has it, else his size if he is large, else his life."""
    if is_untouchable(world) or world.safe_timer > 0:
        return
    if world.large:
        _begin_change(world, world.fire, False, -_CHANGE_TICKS)
        world.safe_timer = _SAFE_TICKS
    else:
        die(world)


@jit
def grow(world: World, fire: bool) -> None:
    """Apply a mushroom or, with `fire`, a flower; it is a coin if Mario has its effect already."""
    if is_untouchable(world):
        return
    if world.fire if fire else world.large:
        world.coins += 1
    else:
        _begin_change(world, True, fire, _CHANGE_TICKS)


@jit
def bounce(world: World, level: LevelMap, y: np.float32, height: int) -> None:
    """Let Mario bounce off an actor whose feet are at `y`."""
    mario = world.actors[0]
    move_vertically(world, level, mario, y - np.float32(height // 2) - mario.y)
    world.jump_vx = _ZERO
    world.jump_vy = _BOUNCE_VY
    world.jump_count = _BOUNCE_COUNT
    mario.vy = np.float32(_BOUNCE_COUNT) * _BOUNCE_VY
    mario.grounded = False
    world.wall_slide = False
    world.safe_timer = 1


@jit
def _begin_change(world: World, large: bool, fire: bool, timer: int) -> None:
    world.frozen = True
    world.change_timer = timer
    world.last_large = world.large
    world.last_fire = world.fire
    world.new_large = large
    world.new_fire = fire
    show_size(world, large, fire)


@jit
def show_size(world: World, large: bool, fire: bool) -> None:
    world.large = large
    world.fire = fire
    world.actors[0].height = 24 if large else 12


@jit
def _change_size(world: World, mario: Actor) -> None:
    """Flicker between the new and the previous size; the size shown also counts in collisions."""
    world.change_timer -= 1 if world.change_timer > 0 else -1
    if abs(world.change_timer) // 3 % 2 == 0:
        show_size(world, world.new_large, world.new_fire)
    else:
        show_size(world, world.last_large, world.last_fire)
    if world.change_timer == 0:
        world.frozen = False


@jit
def _fall_dead(world: World, mario: Actor) -> None:
    world.death_timer += 1
    if world.death_timer < _DEATH_PAUSE:
        mario.vx = _ZERO
        mario.vy = _ZERO
    elif world.death_timer == _DEATH_PAUSE:
        mario.vy = _DEATH_LEAP
    else:
        mario.vy += _TWO
    mario.x += mario.vx
    mario.y += mario.vy


@jit
def _walk_and_jump(world: World, level: LevelMap, mario: Actor) -> None:
    if world.safe_timer > 0:
        world.safe_timer -= 1
    world.was_grounded = mario.grounded
    if mario.vx > _TWO:
        mario.facing = 1
    if mario.vx < -_TWO:
        mario.facing = -1
    _jump(world, mario)
    _run(world, mario)
    _fire(world, level, mario)
    if abs(mario.vx) < _HALF:
        mario.vx = _ZERO
    if world.wall_slide:
        mario.vy *= _HALF
    mario.grounded = False
    move_sideways(world, level, mario, mario.vx)
    move_vertically(world, level, mario, mario.vy)
    _meet_borders(world, level, mario)
    mario.vy = np.float32(np.float64(mario.vy) * world.accel_fall)
    mario.vx *= _FRICTION
    if not mario.grounded:
        mario.vy += _GRAVITY
    _carry(world, mario)


@jit
def _jump(world: World, mario: Actor) -> None:
    keeps_going = world.jump_count < 0 and not mario.grounded and not world.wall_slide
    if not (world.button_jump or keeps_going):
        world.jump_count = 0
    elif world.jump_count < 0:  # off a wall
        mario.vx = world.jump_vx
        mario.vy = np.float32(-world.jump_count) * world.jump_vy
        world.jump_count += 1
    elif mario.grounded and world.may_jump:
        world.jump_vx = _ZERO
        world.jump_vy = np.float32(world.speed_jump)
        world.jump_count = world.jump_time
        mario.vy = np.float32(world.jump_count) * world.jump_vy
        mario.grounded = False
        world.wall_slide = False
    elif world.wall_slide and world.may_jump:
        world.jump_vx = np.float32(-mario.facing * _WALL_PUSH)
        world.jump_vy = np.float32(world.speed_slidejump)
        world.jump_count = world.slidejump_time
        mario.vx = world.jump_vx
        mario.vy = np.float32(-world.jump_count) * world.jump_vy
        mario.grounded = False
        world.wall_slide = False
        mario.facing = -mario.facing
    elif world.jump_count > 0:
        mario.vx += world.jump_vx
        mario.vy = np.float32(world.jump_count) * world.jump_vy
        world.jump_count -= 1


@jit
def _run(world: World, mario: Actor) -> None:
    acceleration = np.float32(world.speed_run if world.button_run else world.speed_walk)
    if world.button_left:
        if mario.facing == 1:
            world.wall_slide = False
        mario.vx -= acceleration
        if world.jump_count >= 0:
            mario.facing = -1
    if world.button_right:
        if mario.facing == -1:
            world.wall_slide = False
        mario.vx += acceleration
        if world.jump_count >= 0:
            mario.facing = 1
    if not (world.button_left or world.button_right) or mario.vy < _ZERO or mario.grounded:
        world.wall_slide = False


@jit
def _fire(world: World, level: LevelMap, mario: Actor) -> None:
    """Throw a fireball if the button is pressed; rearm the buttons when they are released."""
    if world.button_run and world.may_fire and world.fire and world.fireballs_seen < _FIREBALLS:
        add_fireball(
            world, level, mario.x + np.float32(mario.facing * 6), mario.y - np.float32(20), mario.facing
        )
    world.may_fire = not world.button_run
    world.may_jump = (mario.grounded or world.wall_slide) and not world.button_jump


@jit
def _meet_borders(world: World, level: LevelMap, mario: Actor) -> None:
    if mario.y > _BOTTOM:
        die(world)
    if mario.x < _ZERO:
        mario.x = _ZERO
        mario.vx = _ZERO
    if mario.x > 16 * level.exit_x:
        world.frozen = True
        world.win_timer = 1
    if mario.x > 16 * level.columns:
        mario.x = np.float32(16 * level.columns)
        mario.vx = _ZERO


@jit
def _carry(world: World, mario: Actor) -> None:
    """Carry the shell in front of Mario, or release it."""
    if not world.carrying:
        return
    shell = world.actors[world.carrying]
    ahead = np.float32(_HOLD_AHEAD * mario.facing)
    shell.x = mario.x + ahead
    shell.y = mario.y - _HOLD_UP
    if not world.button_run:
        shell.carried = False
        shell.facing = mario.facing
        shell.x += ahead
        world.carrying = 0
