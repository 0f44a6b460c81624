"""An agent's belief about a game of Infinite Mario, formed from observations only.

Agents use `env_server.mario.model`, which also explains the arguments.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from env_server.mario.observation import BODY_SIZE, CHAR_OF, COLUMNS_SHOWN, encode
from env_server.mario.sim import tiles as tile
from env_server.mario.sim.physics import show_size
from env_server.mario.sim.state import (
    ACTORS,
    COLUMNS,
    FIREBALL,
    FLOWER,
    FREE,
    MUSHROOM,
    PLANT,
    ROWS,
    SHELL,
    SPAWN_WINGED,
    TICKS_PER_ACTION,
    Actor,
    LevelMap,
    World,
    fill_actor,
)
from env_server.mario.sim.step import rewind
from env_server.mario.sim.tiles import CHANGED, behavior_at, set_tile, tile_at, write_cells
from glue.compiled.jit import jit
from glue.types import PREFIX_SIZE

_FAR: Final = 2**20
_RISEN: Final = 9  # age of an item that has left its block
_UNKNOWN: Final = 24  # number of columns beyond the view that are guessed
_CLOSE: Final = np.float32(0.01)  # pixels
_LOWEST_CEILING: Final = 5  # row
_FLOOR: Final = tile.STOPS_ALL | tile.STOPS_FALL

_CODE_OF_CHAR: Final = np.zeros(256, np.uint8)
for _char, _code in {
    "1": tile.HILL_TOP_LEFT,
    "2": 1,
    "3": 1,
    "7": tile.STAIR,  # solid, and nothing else
    "b": tile.BRICK_WITH_COIN,  # assumed until it is hit; one in five holds a coin
    "?": tile.QUESTION_WITH_COIN,
    "|": tile.PIPE_MOUTH,
    "$": tile.COIN,
}.items():
    _CODE_OF_CHAR[ord(_char)] = _code
_MARIO: Final = ord("M")
_GOAL: Final = ord("!")
_SOLID: Final = ord("7")
_BRICK: Final = ord("b")

Bytes = npt.NDArray[np.uint8]


@jit
def start(world: World, level: LevelMap, seen: npt.NDArray[np.int64], body: Bytes) -> int:
    """Begin an episode with its first observation; return how many tiles differ from those seen before."""
    if seen[0] == 0:
        level.exit_x = _FAR
        level.spawns[:] = 0
    for column in range(COLUMNS):  # a saved level has only its tiles and spawn points
        write_cells(level, column)
    world.changed[:] = 0
    tiles = read_tiles(world, level, seen, body)
    rewind(world, level)
    correct(world, level, seen, body)
    return tiles


@jit
def predicts(world: World, level: LevelMap, body: Bytes) -> bool:
    """Return whether Mario and all other actors match an observation to the last bit."""
    ours = np.empty(BODY_SIZE, np.uint8)
    encode(world, level, ours)
    words = body.view(np.int32)
    return _same(ours, body, PREFIX_SIZE + 8 * words[1] + 4 * words[0])


@jit
def finds(world: World, body: Bytes) -> bool:
    """Return whether Mario's position matches an observation to the last bit."""
    reals = body.view(np.float64)[PREFIX_SIZE // 8 :]
    mario = world.actors[0]
    return bool(mario.x == _single(reals[0]) and mario.y == _height(reals[1]))


@jit
def correct(world: World, level: LevelMap, seen: npt.NDArray[np.int64], body: Bytes) -> bool:
    """Correct the belief by an observation; return whether it matched already, apart from new columns."""
    words = body.view(np.int32)
    count = words[1] // 4
    is_same = predicts(world, level, body)
    tiles = read_tiles(world, level, seen, body)
    if not is_same:
        reals = body.view(np.float64)[PREFIX_SIZE // 8 :]
        numbers = words[PREFIX_SIZE // 4 + 8 * count :]
        _correct_mario(world, level, numbers, reals)
        _correct_actors(world, level, count - 1, numbers[3:], reals[4:])
    return is_same and tiles == 0


@jit
def place(world: World, level: LevelMap, body: Bytes) -> None:
    """Move Mario to his observed position; everything else stays as predicted."""
    words = body.view(np.int32)
    numbers = words[PREFIX_SIZE // 4 + 2 * words[1] :]
    _correct_mario(world, level, numbers, body.view(np.float64)[PREFIX_SIZE // 8 :])


@jit
def _same(ours: Bytes, theirs: Bytes, size: int) -> bool:
    return bool(np.array_equal(ours[:size], theirs[:size]))


@jit
def read_tiles(world: World, level: LevelMap, seen: npt.NDArray[np.int64], body: Bytes) -> int:
    """Write the tiles that differ in an observation; return how many of them had been seen before."""
    corrected = 0
    words = body.view(np.int32)
    chars = body[PREFIX_SIZE + 8 * words[1] + 4 * words[0] :]
    first = words[PREFIX_SIZE // 4 + 2 * words[1]]
    world.drawn_camera = first * 16 + world.drawn_camera % 16
    for j in range(COLUMNS_SHOWN):
        column = first + j
        if column >= COLUMNS:
            break
        if chars[j] == _GOAL:
            level.exit_x = column
            if column >= seen[0] and column > 0:
                level.tiles[column] = level.tiles[column - 1]
                write_cells(level, column)
            continue
        for row in range(ROWS):
            char = chars[row * (COLUMNS_SHOWN + 1) + j]
            if char == _MARIO:
                if column >= seen[0]:
                    level.tiles[column, row] = tile.EMPTY
            elif column >= seen[0]:
                level.tiles[column, row] = _CODE_OF_CHAR[char]
                world.changed[column] &= ~(1 << row)
            elif CHAR_OF[tile_at(world, level, column, row)] != char:
                _correct_tile(world, level, column, row, char)
                corrected += 1
        if column >= seen[0]:
            write_cells(level, column)
    _see(world, level, seen)
    return corrected


@jit
def _correct_tile(world: World, level: LevelMap, column: int, row: int, char: int) -> None:
    """Make a tile look as observed; where play explains the change, keep the original for later episodes."""
    code = level.tiles[column, row]
    unchanged = world.changed[column] >> row & 1 == 0
    if unchanged and code == tile.BRICK and char == _SOLID:
        set_tile(level, column, row, tile.BRICK_WITH_COIN)
        world.changed[column] |= 1 << row
    elif unchanged and CHAR_OF[CHANGED[code]] == char:
        world.changed[column] |= 1 << row
    else:
        was_hit = code == tile.BRICK_WITH_COIN and not unchanged and char == _BRICK
        set_tile(level, column, row, tile.BRICK if was_hit else _CODE_OF_CHAR[char])
        world.changed[column] &= ~(1 << row)


@jit
def _see(world: World, level: LevelMap, seen: npt.NDArray[np.int64]) -> None:
    """Mark the columns of the window as seen, and guess those beyond it: the last ground continues."""
    end = min(world.drawn_camera // 16 + COLUMNS_SHOWN, COLUMNS)
    if end <= seen[0]:
        return
    seen[0] = end
    column, bottom = end - 1, _lowest_solid(level, end - 1)
    while column > 0 and bottom < 0:
        column -= 1
        bottom = _lowest_solid(level, column)
    top = bottom
    while top > 0 and CHAR_OF[level.tiles[column, top - 1]] == _SOLID:
        top -= 1
    for guessed in range(end, min(end + _UNKNOWN, COLUMNS)):
        level.tiles[guessed] = tile.EMPTY
        level.tiles[guessed, max(top, 0) :] = tile.STAIR
        write_cells(level, guessed)


@jit
def _lowest_solid(level: LevelMap, column: int) -> int:
    """Return the lowest row of a column's ground, filled or not; -1 without ground."""
    for row in range(ROWS - 1, _LOWEST_CEILING, -1):
        if CHAR_OF[level.tiles[column, row]] == _SOLID:
            return row
    return -1


@jit
def _single(real: float) -> np.float32:
    return np.float32(real * 16.0)


@jit
def _height(real: float) -> np.float32:
    return np.float32((16.0 - real) * 16.0)


@jit
def _correct_mario(
    world: World, level: LevelMap, numbers: npt.NDArray[np.int32], reals: npt.NDArray[np.float64]
) -> None:
    mario = world.actors[0]
    x, y = _single(reals[0]), _height(reals[1])
    dx = np.float32(reals[2] * 16.0 / 5.0)
    dy = np.float32(-reals[3] * 16.0 / 5.0)
    large, fire = bool(numbers[1] >= 10), bool(numbers[1] == 11)
    if large != world.large or fire != world.fire:
        world.change_timer = 0
        world.frozen = False
        show_size(world, large, fire)
    if mario.x == x and mario.y == y:
        return
    # A correct prediction keeps its hidden state: landing, for one, does not clear the vertical speed.
    is_fast_as_predicted = abs(mario.x - x) < _CLOSE
    is_high_as_predicted = abs(mario.y - y) < _CLOSE
    mario.x = x
    mario.y = y
    mario.old_x = x - dx
    mario.old_y = y - dy
    world.frozen = False
    world.death_timer = 0
    world.win_timer = 0
    world.change_timer = 0
    if not is_fast_as_predicted:
        mario.vx = dx * np.float32(0.89)
    if is_high_as_predicted:
        return
    mario.vy = np.float32(np.float64(dy) * world.accel_fall)
    below = int(y + np.float32(1)) // 16
    left = behavior_at(world, level, int(x - np.float32(4)) // 16, below)
    right = behavior_at(world, level, int(x + np.float32(4)) // 16, below)
    stands = (left | right) & _FLOOR != 0
    mario.grounded = bool(dy >= 0 and stands and y == np.float32(16 * below - 1))
    if not mario.grounded:
        mario.vy += np.float32(3)
    world.may_jump = mario.grounded and not world.button_jump


@jit
def _correct_actors(
    world: World, level: LevelMap, count: int, numbers: npt.NDArray[np.int32], reals: npt.NDArray[np.float64]
) -> None:
    """Make the actors those observed, in the observed order; each keeps its known state."""
    count = min(count, ACTORS - 1)
    slots = np.zeros(count, np.int64)
    for i in range(count):
        kind = numbers[2 * i]
        x, y = _single(reals[4 * i]), _height(reals[4 * i + 1])
        best, nearest = 0, np.float32(48)
        for j in range(world.listed):
            slot = world.order[j]
            actor = world.actors[slot]
            if actor.kind == kind and not actor.queued:
                distance = abs(actor.x - x) + abs(actor.y - y)
                if distance < nearest:
                    best, nearest = slot, distance
        if best > 0:
            slots[i] = best
            world.actors[best].queued = True  # taken
    for j in range(world.listed):
        actor = world.actors[world.order[j]]
        if not actor.queued:
            actor.kind = FREE
            if world.carrying == world.order[j]:
                world.carrying = 0
        actor.queued = False
    for i in range(count):
        kind, winged = numbers[2 * i], numbers[2 * i + 1] != 0
        x, y = _single(reals[4 * i]), _height(reals[4 * i + 1])
        dx = np.float32(reals[4 * i + 2] * 16.0 / 5.0)
        dy = np.float32(-reals[4 * i + 3] * 16.0 / 5.0)
        is_new = slots[i] == 0
        if is_new:
            slot = 1
            while slot < ACTORS - 1 and world.actors[slot].kind != FREE:
                slot += 1
            slots[i] = slot
        actor = world.actors[slots[i]]
        if is_new:
            facing = 1 if dx > 0 else (0 if kind == SHELL else -1)
            height = 24 if kind <= 2 else (8 if kind == FIREBALL else 12)
            fill_actor(actor, kind, x, y, facing, height)
            actor.age = _RISEN
        if is_new or actor.x != x or actor.y != y or (kind <= PLANT and actor.winged != winged):
            is_as_predicted = abs(actor.x - x) + abs(actor.y - y) < _CLOSE and actor.winged == winged
            actor.x = x
            actor.y = y
            actor.old_x = x - dx
            actor.old_y = y - dy
            actor.winged = winged and kind <= PLANT
            if is_new or not is_as_predicted:
                _infer(world, level, actor, dx, dy, is_new)
            if is_new:
                _remember(world, level, actor, dx, dy)
        world.order[i] = slots[i]
    world.listed = count


@jit
def _infer(world: World, level: LevelMap, actor: Actor, dx: np.float32, dy: np.float32, is_new: bool) -> None:
    """Infer the hidden state of an actor from its last motion; its position is known."""
    if actor.kind == PLANT:
        actor.vy = np.float32(np.float64(dy) * 0.9) + np.float32(0.1)
        column = int(actor.x) // 16
        row = 0
        while row < ROWS and tile_at(world, level, column, row) != tile.PIPE_MOUTH:
            row += 1
        actor.row = row
        actor.column = column
        if is_new:
            actor.age = 0
        return
    if actor.kind == FLOWER or (actor.kind == MUSHROOM and dx == 0 and dy == np.float32(-1)):
        rise = 8 - int(actor.y) % 16
        actor.age = rise if dy < 0 and rise > 0 else 9
        actor.vy = np.float32(0)
        if is_new:
            actor.facing = 1
        return
    flung = actor.kind <= PLANT and abs(abs(dx) - np.float32(2)) < np.float32(0.01)
    if flung:
        actor.flung = True
        actor.dead_timer = max(actor.dead_timer, 90)
        actor.vx = dx
        actor.vy = np.float32(np.float64(dy) * 0.95) + np.float32(1)
        return
    if dx != 0:
        actor.facing = 1 if dx > 0 else -1
        actor.dead_timer = 0
        actor.flung = False
        actor.dead = False
    elif actor.kind == SHELL:
        actor.facing = 0
    actor.vx = dx * np.float32(0.89)
    winged = actor.winged
    actor.grounded = dy == 0
    if actor.kind == FIREBALL:
        actor.vy = dy * np.float32(0.95) + np.float32(1.5)
    elif winged:
        actor.vy = np.float32(-10) if dy == 0 else dy * np.float32(0.95) + np.float32(0.6)
    else:
        actor.vy = dy * np.float32(0.85) + np.float32(2)


@jit
def _remember(world: World, level: LevelMap, actor: Actor, dx: np.float32, dy: np.float32) -> None:
    """Record in the level the origin of an unexpected actor."""
    column, row = int(actor.x) // 16, int(actor.y) // 16
    if actor.kind == PLANT:
        if row < ROWS and actor.row < ROWS:
            level.spawns[column, actor.row] = PLANT
            write_cells(level, column)
    elif actor.kind < PLANT:
        ticks = _spawned_ago(actor.x, dx)
        if ticks == 0:
            return
        column = int(actor.x - np.float32(ticks) * dx) // 16
        if dy == 0 and not actor.winged:  # it fell onto the ground in its second tick
            actor.grounded = ticks > 1
            actor.vy = np.float32(2)
            for _ in range(1, ticks):
                actor.vy *= np.float32(0.85)
        if dy != 0:
            while row < ROWS - 1 and behavior_at(world, level, column, row + 1) & _FLOOR == 0:
                row += 1
        if 0 <= column < COLUMNS and 0 <= row < ROWS:
            level.spawns[column, row] = actor.kind + (SPAWN_WINGED if actor.winged else 0)
            write_cells(level, column)
            actor.column = column
            actor.row = row
    elif actor.kind in (MUSHROOM, FLOWER) and dy == np.float32(-1):
        row = (int(actor.y) + 1) // 16
        if 0 <= row < ROWS:
            is_question = level.tiles[column, row] == tile.QUESTION_WITH_COIN
            code = tile.QUESTION_WITH_POWER_UP if is_question else tile.BRICK_WITH_POWER_UP
            set_tile(level, column, row, code)
            world.changed[column] |= 1 << row


@jit
def _spawned_ago(x: np.float32, dx: np.float32) -> int:
    """Return the ticks since a walker at `x` was created, if that was within this step; otherwise 0."""
    for ticks in range(1, TICKS_PER_ACTION + 1):
        if (x - np.float32(ticks) * dx - np.float32(8)) % np.float32(16) == 0:
            return ticks
    return 0
