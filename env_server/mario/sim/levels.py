"""Level generation: tiles, spawn points and goal column from a seed, difficulty, type and width.

A level is a chain of zones, left to right. All randomness comes from one generator, so the order of
the draws is part of the rules, even where a number drawn has no effect.
Source: RL-Competition 2009, Infinite Mario's level generator.
"""

from __future__ import annotations

from typing import Final

import numpy as np

from env_server.mario.sim import tiles as tile
from env_server.mario.sim.state import GOOMBA, PLANT, RED_KOOPA, ROWS, SPAWN_WINGED, LevelMap
from env_server.mario.sim.tiles import write_cells
from glue.compiled import java_random as random
from glue.compiled.jit import jit

EXTRA_COLUMNS: Final = 50
"""Number of columns of a level beyond its width parameter."""
_ROOM_FOR_ZONE: Final = 64
_OVERGROUND: Final = 0
_DRESS_OF_TYPE: Final = np.array([0, 12, 8])
# The tile of a ground cell by its buried corners: 8 north-west, 4 north-east,
# 2 south-west, 1 south-east. With none buried it stays as it is.
_DRESSED: Final = np.array([0, 128, 130, 129, 160, 144, 145, 131, 162, 145, 146, 147, 161, 179, 163, 145])
GROUND_CODES: Final = {
    tile.GROUND,
    *(int(code) + int(dress) for code in _DRESSED[1:] for dress in _DRESS_OF_TYPE),
}
"""The tiles of ground, in any type of level."""


@jit
def generate(level: LevelMap, seed: int, kind: int, difficulty: int, columns: int) -> None:
    """Generate the level of a seed, type, difficulty and width, unless `level` is that level already."""
    is_same_level = level.seed == seed and level.type == kind and level.difficulty == difficulty
    if is_same_level and level.columns == columns:
        return
    level.seed = seed
    level.type = kind
    level.difficulty = difficulty
    level.columns = columns
    level.tiles[:] = tile.EMPTY
    level.spawns[:] = 0
    rng = random.seeded(seed)
    x = _straight(level, rng, 0, True)
    while x < level.columns - _ROOM_FOR_ZONE:
        x += _zone(level, rng, x)
    _goal(level, rng, x)
    if level.type != _OVERGROUND:
        _ceiling(level, rng)
    finish(level)


@jit
def finish(level: LevelMap) -> None:
    """Give the ground its look, and write the bit fields of all columns."""
    _dress(level)
    for column in range(level.columns):
        write_cells(level, column)


@jit
def _zone(level: LevelMap, rng: random.State, start: int) -> int:
    """Build a zone at column `start`; return its length."""
    difficulty = level.difficulty
    hills = 10 if level.type == _OVERGROUND else 0
    pipes = max(0, 2 + difficulty)
    gap = max(0, 2 * difficulty)
    cannons = max(0, 5 * difficulty - 10)
    choice = random.draw(rng, 20 + hills + pipes + gap + cannons)
    if choice < 20:
        return _straight(level, rng, start, False)
    if choice < 20 + hills:
        return _hills(level, rng, start)
    if choice < 20 + hills + pipes:
        return _pipes(level, rng, start)
    if choice < 20 + hills + pipes + gap:
        return _gap(level, rng, start)
    return 0  # cannons were switched off in the competition, but their share of the draws remained


@jit
def _straight(level: LevelMap, rng: random.State, start: int, safe: bool) -> int:
    length = random.draw(rng, 10) + 2
    if safe:
        length = random.draw(rng, 5) + 10
    length = min(length, level.columns - start)
    floor = _floor(rng)
    _ground(level, start, start + length, floor)
    if not safe and length > 5:
        _decorate(level, rng, start, start + length, floor)
    return length


@jit
def _hills(level: LevelMap, rng: random.State, start: int) -> int:
    """Build a plain with hills on it, each higher than the last."""
    length = min(random.draw(rng, 10) + 10, level.columns - start)
    floor = _floor(rng)
    _ground(level, start, start + length, floor)
    _enemies(level, rng, start + 1, start + length - 1, floor - 1)
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
        _enemies(level, rng, begin, begin + size, top - 1)
        if random.draw(rng, 4) == 0:
            _decorate(level, rng, begin - 1, begin + size + 1, top)
            last = True
        _paint_hill(level, begin, begin + size, top, floor)
    return length


@jit
def _paint_hill(level: LevelMap, begin: int, end: int, top: int, floor: int) -> None:
    for x in range(begin, end):
        code = tile.HILL_TOP_LEFT
        if x == end - 1:
            code = tile.HILL_TOP_RIGHT
        elif x > begin:
            code += 1
        for y in range(top, floor):
            there = level.tiles[x, y]
            if there == tile.EMPTY:
                level.tiles[x, y] = code if y == top else code + 16
            elif there == tile.HILL_TOP_LEFT:
                level.tiles[x, y] = tile.OVERLAPPED_LEFT
            elif there == tile.HILL_TOP_RIGHT:
                level.tiles[x, y] = tile.OVERLAPPED_RIGHT


@jit
def _pipes(level: LevelMap, rng: random.State, start: int) -> int:
    length = min(random.draw(rng, 10) + 5, level.columns - start)
    floor = _floor(rng)
    pipe = start + 1 + random.draw(rng, 4)
    mouth = floor - random.draw(rng, 2) - 2
    for x in range(start, start + length):
        if x > pipe + 1:
            pipe += 3 + random.draw(rng, 4)
            mouth = floor - random.draw(rng, 2) - 2
        if pipe >= start + length - 2:
            pipe += 10
        if x == pipe and random.draw(rng, 11) < level.difficulty + 1:
            level.spawns[x, mouth] = PLANT
        _ground(level, x, x + 1, floor)
        if x in (pipe, pipe + 1):
            level.tiles[x, mouth] = tile.PIPE_MOUTH + x - pipe
            for y in range(mouth + 1, floor):
                level.tiles[x, y] = tile.PIPE_SHAFT + x - pipe
    return length


@jit
def _gap(level: LevelMap, rng: random.State, start: int) -> int:
    bank = random.draw(rng, 4) + 2
    width = random.draw(rng, 2) + 2
    stairs = random.draw(rng, 3) == 0
    floor = _floor(rng)
    length = 2 * bank + width
    for x in range(length):
        if bank <= x < length - bank:
            continue
        _ground(level, start + x, start + x + 1, floor)
        if stairs:
            top = floor - x + 1 if x < bank else floor - (length - x) + 2
            for y in range(top, floor):
                level.tiles[start + x, y] = tile.STAIR
    return length


@jit
def _goal(level: LevelMap, rng: random.State, start: int) -> None:
    floor = _floor(rng)
    level.exit_x = start + 8
    level.exit_y = floor
    _ground(level, start, level.columns, floor)


@jit
def _floor(rng: random.State) -> int:
    return 14 - random.draw(rng, 4)


@jit
def _ground(level: LevelMap, begin: int, end: int, floor: int) -> None:
    level.tiles[begin:end, floor:] = tile.GROUND


@jit
def _enemies(level: LevelMap, rng: random.State, begin: int, end: int, row: int) -> None:
    """Place an enemy in `row` of each column from `begin` up to `end`, at random."""
    difficulty = level.difficulty
    for x in range(begin, end):
        if random.draw(rng, 35) >= difficulty + 1:
            continue
        kind = RED_KOOPA + random.draw(rng, 4)
        if difficulty < 1:
            kind = GOOMBA
        elif difficulty < 3:
            kind = RED_KOOPA + random.draw(rng, 3)
        winged = random.draw(rng, 35) < difficulty
        level.spawns[x, row] = kind + (SPAWN_WINGED if winged else 0)


@jit
def _decorate(level: LevelMap, rng: random.State, begin: int, end: int, floor: int) -> None:
    """Put enemies, coins and blocks over the floor of the columns from `begin` up to `end`."""
    _enemies(level, rng, begin + 1, end - 1, floor - 1)
    first = begin + 1 + random.draw(rng, 4)
    beyond = end - 1 - random.draw(rng, 4)
    if floor > 2 and beyond - first > 1:
        level.tiles[first:beyond, floor - 2] = tile.COIN
    first = begin + 1 + random.draw(rng, 4)
    beyond = end - 1 - random.draw(rng, 4)
    if floor > 4 and beyond - first > 2:
        for x in range(first, beyond):
            level.tiles[x, floor - 4] = _block(rng, x in (begin + 1, end - 2))


@jit
def _block(rng: random.State, at_end: bool) -> int:
    if not at_end and random.draw(rng, 3) == 0:
        return tile.QUESTION_WITH_POWER_UP if random.draw(rng, 4) == 0 else tile.QUESTION_WITH_COIN
    if random.draw(rng, 4) == 0:
        return tile.BRICK_WITH_POWER_UP if random.draw(rng, 4) == 0 else tile.BRICK_WITH_COIN
    return tile.BRICK


@jit
def _ceiling(level: LevelMap, rng: random.State) -> None:
    """Close the level at the left and, in runs of 5 to 8 columns, at the top."""
    level.tiles[0] = tile.GROUND
    run = 0
    depth = 0
    for x in range(5, level.columns):
        if run == 0:
            depth = random.draw(rng, 4)
            run = random.draw(rng, 4) + 5
        level.tiles[x, : depth + 1] = tile.GROUND
        run -= 1


@jit
def _dress(level: LevelMap) -> None:
    """Choose the tiles of ground cells by their neighbours."""
    columns = level.columns
    buried = np.empty((columns + 1, ROWS + 1), np.int64)
    for x in range(columns + 1):
        left = max(x - 1, 0)
        right = min(x, columns - 1)
        for y in range(ROWS + 1):
            above = max(y - 1, 0)
            below = min(y, ROWS - 1)
            buried[x, y] = (
                level.tiles[left, above] == tile.GROUND
                and level.tiles[right, above] == tile.GROUND
                and level.tiles[left, below] == tile.GROUND
                and level.tiles[right, below] == tile.GROUND
            )
    dress = _DRESS_OF_TYPE[level.type]
    for x in range(columns):
        for y in range(ROWS):
            north = 8 * buried[x, y] + 4 * buried[x + 1, y]
            corners = north + 2 * buried[x, y + 1] + buried[x + 1, y + 1]
            if corners:
                level.tiles[x, y] = _DRESSED[corners] + dress
