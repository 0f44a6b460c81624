"""The order of events in a tick, and between one check-in and the next."""

from __future__ import annotations

from typing import Final

import numpy as np

from env_server.mario.sim.contacts import touch_all
from env_server.mario.sim.levels import EXTRA_COLUMNS, generate
from env_server.mario.sim.physics import die, update_mario
from env_server.mario.sim.sprites import add_enemy, update_sprite
from env_server.mario.sim.state import FIREBALL, FREE, MARIO, TICKS_PER_ACTION, LevelMap, World
from glue.compiled.jit import jit

_ZERO: Final = np.float32(0)
_VIEW: Final = 320  # pixels
_HALF_VIEW: Final = 160
_MARGIN: Final = 64
_BELOW: Final = 304


@jit
def begin(world: World, level: LevelMap) -> None:
    """Start an episode and run it up to its first check-in. The buttons keep their state."""
    reset(world, level)
    _run_to_check_in(world, level)
    if not world.started and world.start_ticks > TICKS_PER_ACTION:
        draw(world, level)  # for a check-in that is not reported
        _run_to_check_in(world, level)
    world.started = True


@jit
def rewind(world: World, level: LevelMap) -> None:
    """Begin an episode on the level as it is."""
    clear(world)
    _run_to_check_in(world, level)


@jit
def act(world: World, level: LevelMap, direction: int, jump: int, run: int) -> bool:
    """Carry out an action; return True at the next check-in, False if the episode ended before."""
    world.steps += 1
    world.direction = direction
    world.jump = jump
    world.run = run
    draw(world, level)
    world.playing = not is_over(world) and _run_to_check_in(world, level)
    return world.playing


@jit
def tick(world: World, level: LevelMap) -> None:
    """Advance the world by one tick."""
    if world.steps >= world.max_trial_steps:
        die(world)
    world.camera = _clamp_camera(level, world.actors[0].x - np.float32(_HALF_VIEW))
    _mark_leaving(world)
    if world.frozen:
        for i in range(world.listed):
            actor = world.actors[world.order[i]]
            actor.old_x = actor.x
            actor.old_y = actor.y
        update_mario(world, level)
    else:
        world.tick_count += 1
        _spawn(world, level)
        for i in range(world.listed):
            update_sprite(world, level, world.actors[world.order[i]])
        update_mario(world, level)
        touch_all(world, level)
    _tidy_list(world)


@jit
def draw(world: World, level: LevelMap) -> None:
    """Draw a frame, which fixes the camera position of the next observation."""
    mario = world.actors[0]
    x = mario.old_x + (mario.x - mario.old_x) * world.alpha
    world.drawn_camera = min(max(int(x) - _HALF_VIEW, 0), 16 * level.columns - _VIEW)


@jit
def is_over(world: World) -> bool:
    """Return whether the episode is over, as the next draw would find."""
    return world.win_timer > 0 or world.death_timer > 0


@jit
def _run_to_check_in(world: World, level: LevelMap) -> bool:
    """Run ticks up to the next check-in; return False if the episode ended before."""
    for count in range(1, TICKS_PER_ACTION):
        tick(world, level)
        press_buttons(world, count > 1)
        if not world.draws_at_checkins:
            draw(world, level)
            if is_over(world):
                return False
    tick(world, level)
    press_buttons(world, True)
    return True


@jit
def press_buttons(world: World, all_buttons: bool) -> None:
    """Set the buttons for the next tick; in the first tick of a step jump and run are released."""
    world.button_left = world.direction == -1
    world.button_right = world.direction == 1
    world.button_jump = all_buttons and world.jump == 1
    world.button_run = all_buttons and world.run == 1


@jit
def reset(world: World, level: LevelMap) -> None:
    """Generate the level if it differs, and reset everything except the buttons for a new episode."""
    columns = world.level_width + EXTRA_COLUMNS
    generate(level, world.level_seed, world.level_type, world.level_difficulty, columns)
    clear(world)


@jit
def clear(world: World) -> None:
    """Reset everything except the buttons for a new episode on the same level."""
    world.changed[:] = 0
    world.dead[:] = 0
    world.playing = True
    world.steps = 0
    world.coins = 0
    world.kills = 0
    world.paid = 0.0
    world.direction = 0
    world.jump = 0
    world.run = 0
    world.drawn_camera = 0
    world.camera = _ZERO
    world.tick_count = 0
    world.frozen = False
    world.scanned_from = 0
    world.scanned_to = -1
    world.fireballs_seen = 0
    world.large = False
    world.fire = False
    world.new_large = False
    world.new_fire = False
    world.last_large = False
    world.last_fire = False
    world.was_grounded = False
    world.wall_slide = False
    world.may_jump = False
    world.may_fire = False
    world.jump_count = 0
    world.jump_vx = _ZERO
    world.jump_vy = _ZERO
    world.change_timer = 0
    world.safe_timer = 0
    world.death_timer = 0
    world.win_timer = 0
    world.carrying = 0
    world.listed = 0
    world.added = 0
    for slot in range(len(world.actors)):
        world.actors[slot].kind = FREE
    mario = world.actors[0]
    mario.kind = MARIO
    mario.x = np.float32(32)
    mario.y = _ZERO
    mario.vx = _ZERO
    mario.vy = _ZERO
    mario.old_x = mario.x
    mario.old_y = mario.y
    mario.facing = 1
    mario.height = 12
    mario.grounded = False


@jit
def _clamp_camera(level: LevelMap, x: np.float32) -> np.float32:
    x = max(x, _ZERO)
    return min(x, np.float32(16 * level.columns - _VIEW))


@jit
def _mark_leaving(world: World) -> None:
    """Mark actors that are off the screen, and count the fireballs on it."""
    world.fireballs_seen = 0
    for i in range(world.listed):
        actor = world.actors[world.order[i]]
        dx = actor.x - world.camera
        if dx < -_MARGIN or dx > _VIEW + _MARGIN or actor.y < -_MARGIN or actor.y > _BELOW:
            actor.leaving = True
        elif actor.kind == FIREBALL:
            world.fireballs_seen += 1


@jit
def _spawn(world: World, level: LevelMap) -> None:
    """Create the enemies of the spawn points that have come into view."""
    first = int(world.camera) // 16 - 1
    last = int(world.camera + np.float32(_VIEW)) // 16 + 1
    if first == world.scanned_from and last == world.scanned_to:
        return
    for column in range(max(first, 0), min(last, level.columns - 1) + 1):
        if world.scanned_from <= column <= world.scanned_to:
            continue
        alive = int(level.spawning[column]) & ~int(world.dead[column])
        row = 0
        while alive:
            if alive & 1 and not _has_enemy(world, column, row):
                add_enemy(world, level, column, row, _towards(world, column))
            alive >>= 1
            row += 1
    world.scanned_from = first
    world.scanned_to = last


@jit
def _has_enemy(world: World, column: int, row: int) -> bool:
    """Return whether the last enemy of a spawn point still exists."""
    for i in range(world.listed):
        actor = world.actors[world.order[i]]
        if actor.column == column and actor.row == row:
            return True
    return False


@jit
def _towards(world: World, column: int) -> int:
    """Return the initial facing of an enemy of a column: -1 if Mario is over a tile to its left, else 1."""
    middle = np.float32(16 * column + 8)
    return -1 if middle > world.actors[0].x + np.float32(16) else 1


@jit
def _tidy_list(world: World) -> None:
    """Put new actors in front of the list, as a block, oldest first; then remove the marked actors."""
    added = world.added
    if added:
        for i in range(world.listed - 1, -1, -1):
            world.order[i + added] = world.order[i]
        for i in range(added):
            world.order[i] = world.waiting[i]
        world.listed += added
        world.added = 0
    kept = 0
    for i in range(world.listed):
        slot = world.order[i]
        actor = world.actors[slot]
        if actor.leaving:
            actor.kind = FREE
            if world.carrying == slot:
                world.carrying = 0  # the carried shell is gone, which no observation shows
        else:
            world.order[kept] = slot
            kept += 1
    world.listed = kept
