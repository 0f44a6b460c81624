"""Observations of Infinite Mario, decoded for drawing and for messages, and scenes between two of them.

An observation is made every fifth tick of the game. In between, sprites follow the curve that fits
their two positions and speeds; a sprite in only one of the two is shown for half of the time.

Source: RL-Competition 2009, Infinite Mario's observation; docs/mario.md describes it.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from glue.cli.screen import Marks
from glue.errors import SimulatorError
from glue.types import Observation

ROWS: Final = 16
COLUMNS: Final = 21
_MAX_SPRITES: Final = 1000
_FAR: Final = 1e6
_PRINTABLE: Final = bytes(code if 32 <= code < 127 else ord(" ") for code in range(256))
KINDS: Final = {
    0: "Mario",
    10: "large Mario",
    11: "fire Mario",
    1: "red koopa",
    2: "green koopa",
    3: "goomba",
    4: "spiky",
    5: "piranha plant",
    6: "mushroom",
    7: "fire flower",
    8: "fireball",
    9: "shell",
}
_NEAR: Final = 3.0  # tiles; a sprite farther from its expected position is a different one


class Sprite(NamedTuple):
    """Mario or a monster.

    `x` and `height` are in tiles, from the level's left border and from one tile below its bottom;
    `speed_x` and `speed_y` (up is positive) in tiles per step.
    """

    kind: int
    winged: bool
    x: float
    height: float
    speed_x: float
    speed_y: float

    @property
    def cell(self) -> tuple[int, int]:
        """Row and column of the tile that its feet are in, columns counted from the level's border."""
        return ROWS - 1 - int(self.height), int(self.x)


class Scene(NamedTuple):
    """`rows` are 16 texts of 21 tiles, beginning at level column `column`; Mario is sprite 0.

    `marks` are points that an agent wants drawn, x and height as those of a sprite.
    """

    column: int
    rows: tuple[str, ...]
    sprites: tuple[Sprite, ...]
    marks: Marks = ()


def is_scene(observation: Observation) -> bool:
    """Return whether the counts of `observation` are those of an observation of Infinite Mario."""
    ints, doubles, chars = observation.counts
    return ints >= 3 and ints % 2 == 1 and doubles == 2 * (ints - 1) and chars == ROWS * (COLUMNS + 1)


def read_scene(observation: Observation) -> Scene:
    """Read a scene from an observation of any origin, such as an untrusted recording.

    Raises:
        SimulatorError: `observation` is not of Infinite Mario, or is impossible in any level.
    """
    if not is_scene(observation):
        ints, doubles, chars = observation.counts
        raise SimulatorError(
            "an observation of Infinite Mario has 1 + 2n ints, 4n doubles and 352 chars (n >= 1); "
            f"received {ints} ints, {doubles} doubles and {chars} chars"
        )
    places = observation.doubles.reshape(-1, 4)
    if len(places) > _MAX_SPRITES or not (np.abs(places) < _FAR).all():
        raise SimulatorError(
            f"an observation of Infinite Mario has at most {_MAX_SPRITES} sprites, each less than {_FAR:g} "
            f"tiles away; received {len(places)}, the farthest {np.abs(places).max()} away"
        )
    column, *kinds = observation.ints.tolist()
    tiles = observation.chars.translate(_PRINTABLE).decode("ascii")
    return Scene(
        column,
        tuple(tiles[start : start + COLUMNS] for start in range(0, len(tiles), COLUMNS + 1)),
        tuple(
            Sprite(kind, winged == 1, *place)
            for kind, winged, place in zip(kinds[::2], kinds[1::2], places.tolist(), strict=True)
        ),
    )


def element_name(part: str, index: int) -> str:
    """Return the meaning of element `index` of an observation's ints, doubles or chars.

    Args:
        part: `int`, `double` or `char`.
    """
    if part == "char":
        row, column = divmod(index, COLUMNS + 1)
        return f"row {row}, column {column}"
    if part == "double":
        sprite, field = divmod(index, 4)
        return f"{('x', 'height', 'horizontal speed', 'vertical speed')[field]} of sprite {sprite}"
    if index == 0:
        return "the camera's column"
    sprite, field = divmod(index - 1, 2)
    return f"{('kind', 'winged')[field]} of sprite {sprite}"


def buried_cells(scene: Scene) -> set[tuple[int, int]]:
    """Return the cells of the window, as row and column in it, that are inside the ground.

    An observation shows only the solid outside of ground, its hills and ceilings; their inside is
    blank, as the air is. Air is the blank area connected with Mario's position.
    """
    row, column = scene.sprites[0].cell
    column -= scene.column
    reached = {(min(max(row, 0), ROWS - 1), min(max(column, 0), COLUMNS - 1))}
    edge = list(reached)
    while edge:
        row, column = edge.pop()
        for cell in ((row - 1, column), (row + 1, column), (row, column - 1), (row, column + 1)):
            inside = 0 <= cell[0] < ROWS and 0 <= cell[1] < COLUMNS
            if inside and cell not in reached and not is_ground(scene.rows[cell[0]], cell[1]):
                reached.add(cell)
                edge.append(cell)
    return {
        (row, column)
        for row in range(ROWS)
        for column in range(COLUMNS)
        if scene.rows[row][column] in " !"
        and (row, column) not in reached
        and not is_ground(scene.rows[row], column)
    }


def is_ground(row: str, column: int) -> bool:
    """Return whether a tile of a row is solid; the goal's column hides ground that its neighbors show."""
    return row[column] == "7" or (row[column] == "!" and "7" in row[max(0, column - 1) : column + 2])


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
