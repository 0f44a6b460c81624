"""Tiles and sprites as objects, and the relations that make an object matter to Mario.

Source: Mohan (2010), sections 5 and 6.
"""

from __future__ import annotations

from agents.mario.monsters import find_monsters, recognise_monsters
from agents.mario.observation import (
    BLANK,
    COIN,
    COLUMNS,
    FINISH,
    LEDGE,
    OUTSIDE,
    QUESTION,
    ROWS,
    SOLID,
    Screen,
    read,
    tile,
)
from agents.mario.scene import A_COIN, A_PIT, A_QUESTION, Scene, Senses, add
from glue.compiled.jit import jit


@jit
def look(scene: Scene, senses: Senses, body: bytes) -> bool:
    """Fill in `scene` from an observation's body; return False when its layout is not Mario's.

    All monsters are listed, in the order of the observation, and all other objects that are related.
    """
    screen = scene.screen
    if not read(body, screen):
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
    for row in range(ROWS):
        for k in range(COLUMNS):
            seen = screen.tiles[row, k]
            if seen in (COIN, QUESTION):
                column = screen.camera + k
                dx = column - screen.column
                dy = row - screen.row
                near = coin_is_reachable(dx, dy) if seen == COIN else question_is_reachable(dx, dy)
                if near or via_platform(scene, column, row):
                    add(scene, A_COIN if seen == COIN else A_QUESTION, column * ROWS + row, dx, dy)


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
def platform_is_reachable(start: int, end: int, row: int, screen: Screen) -> bool:
    """Return whether Mario can jump onto a platform."""
    return row - screen.row < 3 and start - screen.column < 4 and end - screen.column > -3


@jit
def _find_platforms(scene: Scene) -> None:
    """List the reachable platforms, except those that leave the view on either side."""
    screen = scene.screen
    scene.platform_count = 0
    for row in range(ROWS):
        start = 0  # the column in view where a run may have begun; 0 for none
        for k in range(1, COLUMNS):
            seen = screen.tiles[row, k]
            before = screen.tiles[row, k - 1]
            if seen == LEDGE and before == BLANK:
                start = k
            if seen != LEDGE:
                if start > 0 and before == LEDGE and seen == BLANK:
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
    for k in range(1, COLUMNS):
        if _is_open(screen, k):
            if screen.tiles[0, k - 1] == SOLID:
                start = k
        else:
            if start > 0 and screen.tiles[0, k] == SOLID:
                first = screen.camera + start
                last = screen.camera + k - 1
                if pit_is_dangerous(first - screen.column, last - screen.column):
                    add(scene, A_PIT, first, first - screen.column, 0)
            start = 0


@jit
def _is_open(screen: Screen, k: int) -> bool:
    for row in range(ROWS):
        seen = screen.tiles[row, k]
        if seen in (SOLID, FINISH):
            return False
    return True


@jit
def pit_is_dangerous(start: int, end: int) -> bool:
    """Return whether Mario is about to enter a pit from `start` to `end` tiles to the right."""
    return start <= 2 and end >= 0


# Single tiles


@jit
def tile_above(screen: Screen) -> int:
    """Return the tile that a jump from the floor below Mario would hit: four rows above that floor."""
    for row in range(min(screen.row, ROWS) - 1, -1, -1):
        if tile(screen, screen.column, row) == SOLID:
            return tile(screen, screen.column, row + 4)
    return OUTSIDE
