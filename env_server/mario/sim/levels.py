"""Level generation: tiles, spawn points and goal column from a seed, difficulty, type and width.

A level is a chain of zones, left to right. All randomness comes from one generator, so the order of
the draws is part of the rules, even where a number drawn has no effect.
Source: RL-Competition 2009, Infinite Mario's level generator.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from env_server.mario.sim import tiles as tile
from env_server.mario.sim.state import GOOMBA, PLANT, RED_KOOPA, ROWS, SPAWN_WINGED, World
from env_server.mario.sim.tiles import set_tile
from glue.compiled import java_random as random
from glue.compiled.jit import jit

__all__ = ["EXTRA_COLUMNS", "generate"]

EXTRA_COLUMNS: Final = 50
"""Number of columns of a level beyond its width parameter."""
_ROOM_FOR_ZONE: Final = 64
_OVERGROUND: Final = 0
_DRESS_OF_TYPE: Final = np.array([0, 12, 8])
# What a ground cell becomes by which of its corners are buried: 8 north-west, 4 north-east,
# 2 south-west, 1 south-east. With none buried it stays as it is.
_DRESSED: Final = np.array(
    [0, 128, 130, 129, 160, 144, 145, 131, 162, 145, 146, 147, 161, 179, 163, 145],
)


@jit
def generate(world: World) -> None:
    """Generate the level of the task of `world`."""
    world.columns = world.level_width + EXTRA_COLUMNS
    world.tiles[: world.columns] = tile.EMPTY
    world.spawns[: world.columns] = 0
    rng = random.seeded(world.level_seed)
    x = _straight(world, rng, 0, True)
    while x < world.columns - _ROOM_FOR_ZONE:
        x += _zone(world, rng, x)
    _goal(world, rng, x)
    if world.level_type != _OVERGROUND:
        _ceiling(world, rng)
    _dress(world)


@jit
def _zone(world: World, rng: random.State, start: int) -> int:
    """Build a zone at column `start`; return its length."""
    difficulty = world.level_difficulty
    hills = 10 if world.level_type == _OVERGROUND else 0
    pipes = max(0, 2 + difficulty)
    gap = max(0, 2 * difficulty)
    cannons = max(0, 5 * difficulty - 10)
    choice = random.draw(rng, 20 + hills + pipes + gap + cannons)
    if choice < 20:
        return _straight(world, rng, start, False)
    if choice < 20 + hills:
        return _hills(world, rng, start)
    if choice < 20 + hills + pipes:
        return _pipes(world, rng, start)
    if choice < 20 + hills + pipes + gap:
        return _gap(world, rng, start)
    return 0  # cannons were switched off in the competition, but their share of the draws remained


@jit
def _straight(world: World, rng: random.State, start: int, safe: bool) -> int:
    length = random.draw(rng, 10) + 2
    if safe:
        length = random.draw(rng, 5) + 10
    length = min(length, world.columns - start)
    floor = _floor(rng)
    _ground(world, start, start + length, floor)
    if not safe and length > 5:
        _decorate(world, rng, start, start + length, floor)
    return length


@jit
def _hills(world: World, rng: random.State, start: int) -> int:
    """Build a plain with hills on it, each higher than the last."""
    length = min(random.draw(rng, 10) + 10, world.columns - start)
    floor = _floor(rng)
    _ground(world, start, start + length, floor)
    _enemies(world, rng, start + 1, start + length - 1, floor - 1)
    taken = np.zeros(length + 2, np.bool_)  # where each hill begins, and the column after its end
    top = floor
    last = False
    while not last:
        top -= 2 + random.draw(rng, 3)
        if top <= 0:
            break
        size = random.draw(rng, 5) + 3
        left = random.draw(rng, length - size - 2) + 1
        if taken[left - 1] or taken[left] or taken[left + size] or taken[left + size + 1]:
            break
        taken[left] = True
        taken[left + size] = True
        begin = start + left
        _enemies(world, rng, begin, begin + size, top - 1)
        if random.draw(rng, 4) == 0:
            _decorate(world, rng, begin - 1, begin + size + 1, top)
            last = True
        _paint_hill(world, begin, begin + size, top, floor)
    return length


@jit
def _paint_hill(world: World, begin: int, end: int, top: int, floor: int) -> None:
    for x in range(begin, end):
        code = tile.HILL_TOP_LEFT
        if x == end - 1:
            code = tile.HILL_TOP_RIGHT
        elif x > begin:
            code += 1
        for y in range(top, floor):
            there = world.tiles[x, y]
            if there == tile.EMPTY:
                world.tiles[x, y] = code if y == top else code + 16
            elif there == tile.HILL_TOP_LEFT:
                world.tiles[x, y] = tile.OVERLAPPED_LEFT
            elif there == tile.HILL_TOP_RIGHT:
                world.tiles[x, y] = tile.OVERLAPPED_RIGHT


@jit
def _pipes(world: World, rng: random.State, start: int) -> int:
    length = min(random.draw(rng, 10) + 5, world.columns - start)
    floor = _floor(rng)
    pipe = start + 1 + random.draw(rng, 4)
    mouth = floor - random.draw(rng, 2) - 2
    for x in range(start, start + length):
        if x > pipe + 1:
            pipe += 3 + random.draw(rng, 4)
            mouth = floor - random.draw(rng, 2) - 2
        if pipe >= start + length - 2:
            pipe += 10
        if x == pipe and random.draw(rng, 11) < world.level_difficulty + 1:
            world.spawns[x, mouth] = PLANT
        _ground(world, x, x + 1, floor)
        if x in (pipe, pipe + 1):
            world.tiles[x, mouth] = tile.PIPE_MOUTH + x - pipe
            for y in range(mouth + 1, floor):
                world.tiles[x, y] = tile.PIPE_SHAFT + x - pipe
    return length


@jit
def _gap(world: World, rng: random.State, start: int) -> int:
    bank = random.draw(rng, 4) + 2
    width = random.draw(rng, 2) + 2
    stairs = random.draw(rng, 3) == 0
    floor = _floor(rng)
    length = 2 * bank + width
    for x in range(length):
        if bank <= x < length - bank:
            continue
        _ground(world, start + x, start + x + 1, floor)
        if stairs:
            top = floor - x + 1 if x < bank else floor - (length - x) + 2
            for y in range(top, floor):
                set_tile(world, start + x, y, tile.STAIR)
    return length


@jit
def _goal(world: World, rng: random.State, start: int) -> None:
    floor = _floor(rng)
    world.exit_x = start + 8
    world.exit_y = floor
    _ground(world, start, world.columns, floor)


@jit
def _floor(rng: random.State) -> int:
    return 14 - random.draw(rng, 4)


@jit
def _ground(world: World, begin: int, end: int, floor: int) -> None:
    world.tiles[begin:end, floor:] = tile.GROUND


@jit
def _enemies(world: World, rng: random.State, begin: int, end: int, row: int) -> None:
    """Place an enemy in `row` of each column from `begin` up to `end`, at random."""
    difficulty = world.level_difficulty
    for x in range(begin, end):
        if random.draw(rng, 35) >= difficulty + 1:
            continue
        kind = RED_KOOPA + random.draw(rng, 4)
        if difficulty < 1:
            kind = GOOMBA
        elif difficulty < 3:
            kind = RED_KOOPA + random.draw(rng, 3)
        winged = random.draw(rng, 35) < difficulty
        world.spawns[x, row] = kind + (SPAWN_WINGED if winged else 0)


@jit
def _decorate(world: World, rng: random.State, begin: int, end: int, floor: int) -> None:
    """Put enemies, coins and blocks over the floor of the columns from `begin` up to `end`."""
    _enemies(world, rng, begin + 1, end - 1, floor - 1)
    first = begin + 1 + random.draw(rng, 4)
    beyond = end - 1 - random.draw(rng, 4)
    if floor > 2 and beyond - first > 1:
        world.tiles[first:beyond, floor - 2] = tile.COIN
    first = begin + 1 + random.draw(rng, 4)
    beyond = end - 1 - random.draw(rng, 4)
    if floor > 4 and beyond - first > 2:
        for x in range(first, beyond):
            world.tiles[x, floor - 4] = _block(rng, x in (begin + 1, end - 2))


@jit
def _block(rng: random.State, at_end: bool) -> int:
    if not at_end and random.draw(rng, 3) == 0:
        return tile.QUESTION_WITH_POWER_UP if random.draw(rng, 4) == 0 else tile.QUESTION_WITH_COIN
    if random.draw(rng, 4) == 0:
        return tile.BRICK_WITH_POWER_UP if random.draw(rng, 4) == 0 else tile.BRICK_WITH_COIN
    return tile.BRICK


@jit
def _ceiling(world: World, rng: random.State) -> None:
    """Close the level at the left and, in runs of 5 to 8 columns, at the top."""
    world.tiles[0] = tile.GROUND
    run = 0
    depth = 0
    for x in range(5, world.columns):
        if run == 0:
            depth = random.draw(rng, 4)
            run = random.draw(rng, 4) + 5
        world.tiles[x, : depth + 1] = tile.GROUND
        run -= 1


@jit
def _dress(world: World) -> None:
    """Choose the tiles of ground cells by their neighbours."""
    columns = world.columns
    buried = np.empty((columns + 1, ROWS + 1), np.int64)
    for x in range(columns + 1):
        left = max(x - 1, 0)
        right = min(x, columns - 1)
        for y in range(ROWS + 1):
            above = max(y - 1, 0)
            below = min(y, ROWS - 1)
            buried[x, y] = (
                world.tiles[left, above] == tile.GROUND
                and world.tiles[right, above] == tile.GROUND
                and world.tiles[left, below] == tile.GROUND
                and world.tiles[right, below] == tile.GROUND
            )
    dress = _DRESS_OF_TYPE[world.level_type]
    for x in range(columns):
        for y in range(ROWS):
            north = 8 * buried[x, y] + 4 * buried[x + 1, y]
            corners = north + 2 * buried[x, y + 1] + buried[x + 1, y + 1]
            if corners:
                world.tiles[x, y] = _DRESSED[corners] + dress
