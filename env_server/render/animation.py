"""Scenes between two observations, for a smooth animation.

An observation is made every fifth tick of the game. In between, sprites follow the curve that fits
their two positions and speeds; a sprite in only one of the two is shown for half of the time.
"""

from __future__ import annotations

from typing import Final

from env_server.render.scene import COLUMNS, ROWS, Scene, Sprite, buried_cells, is_ground

_NEAR: Final = 3.0  # tiles; a sprite farther from its expected position is a different one


def outlined(scene: Scene) -> Scene:
    """Return `scene` with "#" for the inside of the ground, and ground where the goal's column hides it."""
    rows = [list(row) for row in scene.rows]
    for row, line in enumerate(scene.rows):
        for column in range(len(line)):
            if is_ground(line, column):
                rows[row][column] = "7"
    for row, column in buried_cells(scene):
        rows[row][column] = "#"
    return scene._replace(rows=tuple(map("".join, rows)))


def between(before: Scene, after: Scene, time: float) -> Scene:
    """Return the scene at `time`, from 0 (`before`) to 1 (`after`), a step later.

    Its rows span both windows.
    """
    if before == after or abs(after.column - before.column) > COLUMNS:
        return before if time < 0.5 else after
    left = min(before.column, after.column)
    width = abs(after.column - before.column) + COLUMNS
    first, second = (before, after) if time < 0.5 else (after, before)
    rows = tuple(
        "".join(_tile(first, second, row, column) for column in range(left, left + width))
        for row in range(ROWS)
    )
    return Scene(left, rows, tuple(_sprites(before, after, time)), before.marks)


def _tile(first: Scene, second: Scene, row: int, column: int) -> str:
    """Return a tile from the first scene, or else from the second; Mario hides the tile that he is in."""
    tiles = [
        scene.rows[row][column - scene.column]
        for scene in (first, second)
        if 0 <= column - scene.column < COLUMNS
    ]
    return next((tile for tile in tiles if tile != "M"), " ")


def _sprites(before: Scene, after: Scene, time: float) -> list[Sprite]:
    moved = [_moved(before.sprites[0], after.sprites[0], time)]
    left = list(before.sprites[1:])
    for sprite in after.sprites[1:]:
        near = [old for old in left if old.kind == sprite.kind and _distance(old, sprite) < _NEAR]
        if near:
            old = min(near, key=lambda old: _distance(old, sprite))
            left.remove(old)
            moved.append(_moved(old, sprite, time))
        elif time >= 0.5:
            moved.append(_drifted(sprite, time - 1))
    if time < 0.5:
        moved.extend(_drifted(old, time) for old in left)
    return moved


def _distance(old: Sprite, new: Sprite) -> float:
    """Return the distance of `new` from the expected position of `old`."""
    return abs(old.x + old.speed_x - new.x) + abs(old.height + old.speed_y - new.height) / 2


def _moved(old: Sprite, new: Sprite, time: float) -> Sprite:
    nearer = old if time < 0.5 else new
    height = _curve(old.height, old.speed_y, new.height, new.speed_y, time)
    return nearer._replace(
        x=_curve(old.x, old.speed_x, new.x, new.speed_x, time),
        height=max(height, min(old.height, new.height)),  # but not into the ground
    )


def _drifted(sprite: Sprite, time: float) -> Sprite:
    return sprite._replace(x=sprite.x + sprite.speed_x * time, height=sprite.height + sprite.speed_y * time)


def _curve(start: float, speed: float, end: float, end_speed: float, time: float) -> float:
    """Return the value at `time`, from 0 to 1, of the cubic with these ends and speeds at its ends."""
    rest = end - start
    bend = 3 * rest - 2 * speed - end_speed
    snap = speed + end_speed - 2 * rest
    return start + time * (speed + time * (bend + time * snap))
