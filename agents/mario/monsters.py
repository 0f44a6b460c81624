"""Monsters as objects: their identity from one observation to the next, their motion, and the threats.

Source: Mohan (2010), sections 5 and 6; thresholds from the author's Soar agents of 2010 and 2012.
"""

from __future__ import annotations

from typing import Final

from agents.mario.observation import BLANK, COLUMNS, FIREBALL, PIPE, PLANT, ROWS, Screen, Sprite, tile
from agents.mario.scene import (
    A_MONSTER,
    AWAY,
    NO_MOTION,
    STATIONARY,
    TOWARDS,
    VERTICAL,
    Scene,
    Senses,
    add,
)
from glue.compiled.jit import jit

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
        sprite_kind != FIREBALL
        and senses.threat_left * senses.grid <= dx < senses.threat_right * senses.grid
        and senses.threat_below * senses.grid <= dy < senses.threat_above * senses.grid
    )


@jit
def _is_in_pipe(sprite: Sprite, screen: Screen) -> bool:
    """Return whether a sprite is a piranha plant that has withdrawn below the rim of its pipe."""
    if sprite.kind != PLANT:
        return False
    for row in range(ROWS):
        for column in range(screen.camera, screen.camera + COLUMNS):
            if column < sprite.x <= column + 1 and sprite.y < row and _is_pipe_corner(screen, column, row):
                return True
    return False


@jit
def _is_pipe_corner(screen: Screen, column: int, row: int) -> bool:
    return (
        tile(screen, column, row) == PIPE
        and tile(screen, column - 1, row) == BLANK
        and tile(screen, column, row + 1) == BLANK
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
