"""Tiles and sprites as objects, and the relations that make an object matter to Mario; monsters also with
their identity from one observation to the next, their motion, and the threats.

Objects are monsters (every sprite that is not Mario, items too), coins, question blocks and pits.
Distances are object minus Mario: in tiles, y up, for coins, questions and pits; for monsters in
cells of a grid, with positions rounded towards zero before subtraction.
Source: Mohan (2010), sections 5 and 6; thresholds from the author's Soar agents of 2010 and 2012.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Final

import numpy as np
import numpy.typing as npt

from agents.mario import observation
from glue.compiled.jit import jit
from glue.compiled.records import Array, Flag, Int

A_MONSTER: Final = 0
A_QUESTION: Final = 1
A_COIN: Final = 2
A_PIT: Final = 3

STATIONARY: Final = 0
VERTICAL: Final = 1
TOWARDS: Final = 2
AWAY: Final = 3
NO_MOTION: Final = 4
"""Moving sideways in Mario's own column: neither towards him nor away."""

MAX_OBJECTS: Final = observation.MAX_SPRITES + observation.ROWS * observation.COLUMNS + observation.COLUMNS
_MAX_PLATFORMS: Final = observation.ROWS * observation.COLUMNS // 2


class Senses:
    """The parameters of perception, which differ between the agents.

    grid             cells per tile of the distances to monsters
    threat_*         a monster is a threat when threat_left <= dx < threat_right tiles and
                     threat_below <= dy < threat_above tiles
    absolute_motion  whether a monster's motion is the signs of its speeds, or relative to Mario
    via_platforms    whether objects above a reachable platform are reachable
    """

    grid: Int
    threat_left: Int
    threat_right: Int
    threat_below: Int
    threat_above: Int
    absolute_motion: Flag
    via_platforms: Flag


class Object:
    """Something that an operator may act on.

    id       identifies it among its kind for as long as it exists: column * 16 + row of a coin or
             question, the first column of a pit, a unique number of a monster
    type     sprite kind of a monster, otherwise 0
    related  whether it is a threat, reachable, or dangerous
    """

    kind: Int
    id: Int
    type: Int
    dx: Int
    dy: Int
    motion: Int
    related: Flag


class Platform:
    """A run of ledge tiles in one row with blanks on both sides; `start` and `end` are inclusive."""

    start: Int
    end: Int
    row: Int


class Scene:
    """An observation as objects. The fields about monsters persist from step to step."""

    screen: Annotated[observation.Screen, observation.Screen]
    count: Int
    objects: Annotated[Sequence[Object], Object, MAX_OBJECTS]
    platform_count: Int
    platforms: Annotated[Sequence[Platform], Platform, _MAX_PLATFORMS]
    monster_count: Int
    monster_types: Annotated[npt.NDArray[np.int64], np.int64, observation.MAX_SPRITES]
    monster_ids: Annotated[npt.NDArray[np.int64], np.int64, observation.MAX_SPRITES]
    next_id: Int


def set_senses(
    senses: Array,
    grid: int,
    threats: tuple[int, int, int, int],
    absolute_motion: bool = False,
    via_platforms: bool = False,
) -> None:
    """Fill in the parameters of an agent's perception; see `Senses`."""
    senses["grid"] = grid
    for side, tiles in zip(("left", "right", "below", "above"), threats, strict=True):
        senses[f"threat_{side}"] = tiles
    senses["absolute_motion"] = absolute_motion
    senses["via_platforms"] = via_platforms


@jit
def add(scene: Scene, kind: int, identity: int, dx: int, dy: int) -> Object:
    """Add an object that is related and does not move; return it."""
    found = scene.objects[scene.count]
    scene.count += 1
    found.kind = kind
    found.id = identity
    found.type = 0
    found.dx = dx
    found.dy = dy
    found.motion = 0
    found.related = True
    return found


THREATS_2010: Final = (-3, 4, -6, 5)
"""Area in which a monster is a threat: left, right, below, above, in tiles; the author's agents of 2010."""
THREATS_2012: Final = (-4, 6, -2, 5)
"""The same area in the author's agent of 2012."""


@jit
def forget_monsters(scene: Scene) -> None:
    """Forget all monsters, at the beginning of an episode."""
    scene.monster_count = 0


@jit
def recognise_monsters(scene: Scene) -> None:
    """Give every monster its id: that of the monster last seen at its position in the list, if of its type.

    From the first position where the type differs, all are new.
    """
    screen = scene.screen
    known = 0
    while (
        known < screen.count
        and known < scene.monster_count
        and screen.sprites[known].kind == scene.monster_types[known]
    ):
        known += 1
    for i in range(known, screen.count):
        scene.monster_types[i] = screen.sprites[i].kind
        scene.monster_ids[i] = scene.next_id
        scene.next_id += 1
    scene.monster_count = screen.count


@jit
def find_monsters(scene: Scene, senses: Senses) -> None:
    """Add every monster to the scene."""
    screen = scene.screen
    for i in range(screen.count):
        sprite = screen.sprites[i]
        dx = _cell(sprite.x, senses.grid) - _cell(screen.mario.x, senses.grid)
        dy = _cell(sprite.y, senses.grid) - _cell(screen.mario.y, senses.grid)
        monster = add(scene, A_MONSTER, scene.monster_ids[i], dx, dy)
        monster.type = sprite.kind
        monster.related = is_threat(sprite.kind, dx, dy, senses) and not _is_in_pipe(sprite, screen)
        if senses.absolute_motion:
            monster.motion = absolute_motion(sprite.speed_x, sprite.speed_y)
        else:
            monster.motion = relative_motion(dx, sprite.speed_x, sprite.speed_y)


@jit
def _cell(position: float, grid: int) -> int:
    return int(position * grid)


@jit
def is_threat(sprite_kind: int, dx: int, dy: int, senses: Senses) -> bool:
    """Return whether a monster at a distance of (dx, dy) cells is near enough to be dealt with."""
    return (
        sprite_kind != observation.FIREBALL
        and senses.threat_left * senses.grid <= dx < senses.threat_right * senses.grid
        and senses.threat_below * senses.grid <= dy < senses.threat_above * senses.grid
    )


@jit
def _is_in_pipe(sprite: observation.Sprite, screen: observation.Screen) -> bool:
    """Return whether a sprite is a piranha plant that has withdrawn below the rim of its pipe."""
    if sprite.kind != observation.PLANT:
        return False
    for row in range(observation.ROWS):
        for column in range(screen.camera, screen.camera + observation.COLUMNS):
            if column < sprite.x <= column + 1 and sprite.y < row and _is_pipe_corner(screen, column, row):
                return True
    return False


@jit
def _is_pipe_corner(screen: observation.Screen, column: int, row: int) -> bool:
    return (
        observation.tile(screen, column, row) == observation.PIPE
        and observation.tile(screen, column - 1, row) == observation.BLANK
        and observation.tile(screen, column, row + 1) == observation.BLANK
    )


@jit
def relative_motion(dx: int, speed_x: float, speed_y: float) -> int:
    """Return a monster's motion as Mario sees it: STATIONARY, VERTICAL, TOWARDS, AWAY or NO_MOTION."""
    if speed_x == 0.0:
        return STATIONARY if speed_y == 0.0 else VERTICAL
    if dx == 0:
        return NO_MOTION
    return AWAY if (dx > 0) == (speed_x > 0.0) else TOWARDS


@jit
def absolute_motion(speed_x: float, speed_y: float) -> int:
    """Return the signs of a monster's two speeds as one of nine numbers."""
    return 3 * (1 + int(speed_x > 0.0) - int(speed_x < 0.0)) + 1 + int(speed_y > 0.0) - int(speed_y < 0.0)


@jit
def look(scene: Scene, senses: Senses, body: bytes) -> bool:
    """Fill in `scene` from an observation's body; return False when its layout is not Mario's.

    All monsters are listed, in the order of the observation, and all other objects that are related.
    """
    screen = scene.screen
    if not observation.read(body, screen):
        return False
    scene.count = 0
    recognise_monsters(scene)
    find_monsters(scene, senses)
    if senses.via_platforms:
        _find_platforms(scene)
    else:
        scene.platform_count = 0
    _find_coins_and_questions(scene)
    _find_pits(scene)
    return True


# Coins, questions, platforms


@jit
def _find_coins_and_questions(scene: Scene) -> None:
    screen = scene.screen
    for row in range(observation.ROWS):
        for k in range(observation.COLUMNS):
            seen = screen.tiles[row, k]
            if seen in (observation.COIN, observation.QUESTION):
                column = screen.camera + k
                dx = column - screen.column
                dy = row - screen.row
                near = (
                    coin_is_reachable(dx, dy) if seen == observation.COIN else question_is_reachable(dx, dy)
                )
                if near or via_platform(scene, column, row):
                    add(
                        scene,
                        A_COIN if seen == observation.COIN else A_QUESTION,
                        column * observation.ROWS + row,
                        dx,
                        dy,
                    )


@jit
def coin_is_reachable(dx: int, dy: int) -> bool:
    """Return whether Mario can reach a coin this many tiles away."""
    return -1 <= dx <= 1 and 0 <= dy <= 3


@jit
def question_is_reachable(dx: int, dy: int) -> bool:
    """Return whether Mario can hit a question block this many tiles away."""
    return -2 <= dx <= 2 and 0 <= dy <= 3


@jit
def via_platform(scene: Scene, column: int, row: int) -> bool:
    """Return whether a coin or question lies above a reachable platform."""
    for i in range(scene.platform_count):
        platform = scene.platforms[i]
        if platform.start < column < platform.end and 0 <= row - platform.row <= 3:
            return True
    return False


@jit
def platform_is_reachable(start: int, end: int, row: int, screen: observation.Screen) -> bool:
    """Return whether Mario can jump onto a platform."""
    return row - screen.row < 3 and start - screen.column < 4 and end - screen.column > -3


@jit
def _find_platforms(scene: Scene) -> None:
    """List the reachable platforms, except those that leave the view on either side."""
    screen = scene.screen
    scene.platform_count = 0
    for row in range(observation.ROWS):
        start = 0  # the column in view where a run may have begun; 0 for none
        for k in range(1, observation.COLUMNS):
            seen = screen.tiles[row, k]
            before = screen.tiles[row, k - 1]
            if seen == observation.LEDGE and before == observation.BLANK:
                start = k
            if seen != observation.LEDGE:
                if start > 0 and before == observation.LEDGE and seen == observation.BLANK:
                    _add_platform(scene, screen.camera + start, screen.camera + k - 1, row)
                start = 0


@jit
def _add_platform(scene: Scene, start: int, end: int, row: int) -> None:
    if platform_is_reachable(start, end, row, scene.screen):
        platform = scene.platforms[scene.platform_count]
        platform.start = start
        platform.end = end
        platform.row = row
        scene.platform_count += 1


# Pits


@jit
def _find_pits(scene: Scene) -> None:
    """List the dangerous pits: runs of columns without solid tiles, between columns solid at the bottom.

    The column of the finish line hides its ground, and is not a pit.
    """
    screen = scene.screen
    start = 0  # the column in view where a pit may have begun; 0 for none
    for k in range(1, observation.COLUMNS):
        if _is_open(screen, k):
            if screen.tiles[0, k - 1] == observation.SOLID:
                start = k
        else:
            if start > 0 and screen.tiles[0, k] == observation.SOLID:
                first = screen.camera + start
                last = screen.camera + k - 1
                if pit_is_dangerous(first - screen.column, last - screen.column):
                    add(scene, A_PIT, first, first - screen.column, 0)
            start = 0


@jit
def _is_open(screen: observation.Screen, k: int) -> bool:
    for row in range(observation.ROWS):
        seen = screen.tiles[row, k]
        if seen in (observation.SOLID, observation.FINISH):
            return False
    return True


@jit
def pit_is_dangerous(start: int, end: int) -> bool:
    """Return whether Mario is about to enter a pit from `start` to `end` tiles to the right."""
    return start <= 2 and end >= 0


# Single tiles


@jit
def tile_above(screen: observation.Screen) -> int:
    """Return the tile that a jump from the floor below Mario would hit: four rows above that floor."""
    for row in range(min(screen.row, observation.ROWS) - 1, -1, -1):
        if observation.tile(screen, screen.column, row) == observation.SOLID:
            return observation.tile(screen, screen.column, row + 4)
    return observation.OUTSIDE
