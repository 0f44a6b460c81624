"""An observation as objects: the records that hold them.

Objects are monsters (every sprite that is not Mario, items too), coins, question blocks and pits.
Distances are object minus Mario: in tiles, y up, for coins, questions and pits; for monsters in
cells of a grid, with positions rounded towards zero before subtraction.
Source: Mohan (2010), sections 5 and 6.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Final

import numpy as np
import numpy.typing as npt

from agents.mario.observation import COLUMNS, MAX_SPRITES, ROWS, Screen
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

MAX_OBJECTS: Final = MAX_SPRITES + ROWS * COLUMNS + COLUMNS
_MAX_PLATFORMS: Final = ROWS * COLUMNS // 2


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

    screen: Annotated[Screen, Screen]
    count: Int
    objects: Annotated[Sequence[Object], Object, MAX_OBJECTS]
    platform_count: Int
    platforms: Annotated[Sequence[Platform], Platform, _MAX_PLATFORMS]
    monster_count: Int
    monster_types: Annotated[npt.NDArray[np.int64], np.int64, MAX_SPRITES]
    monster_ids: Annotated[npt.NDArray[np.int64], np.int64, MAX_SPRITES]
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
