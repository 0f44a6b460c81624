"""The states of the flat agents, on drawn screens."""

from __future__ import annotations

from typing import cast

import numpy as np
import pytest

from agents.mario.objects import Scene
from agents.mario.observation import GOOMBA, MUSHROOM
from agents.mohan2010.features import WINDOW, all_objects, window_parts, window_whole
from glue.types import Observation
from tests.agents.screens import draw, key, watched

SPRITE = 256
ROOM = ("?  $7", "b M |", "77711")


def whole(observation: Observation) -> int:
    """Return the key of the whole window."""
    return int(window_whole(watched(observation).screen))


def parts(observation: Observation) -> list[int]:
    keys = np.zeros(WINDOW, np.uint64)
    assert window_parts(watched(observation).screen, keys) == WINDOW
    return [int(key) for key in keys]


def test_the_window_is_five_columns_by_three_rows() -> None:
    seen = "77711b   |?  $7"  # from the bottom up; Mario reads as blank
    assert whole(draw(*ROOM)) == key(11, *map(ord, seen))


@pytest.mark.parametrize(
    ("column", "row", "inside"), [(0, 0, True), (4, 2, True), (5, 0, False), (0, 3, False)]
)
def test_only_tiles_of_the_window_count(column: int, row: int, inside: bool) -> None:
    rows = [line.ljust(6) for line in ("      ", *ROOM)]
    plain = whole(draw(*rows))
    line = rows[3 - row]
    rows[3 - row] = line[:column] + "!" + line[column + 1 :]
    assert (whole(draw(*rows)) != plain) is inside


def test_tiles_out_of_view_are_a_symbol_of_their_own() -> None:
    floor, air = [0, 0, *map(ord, "777")], [0, 0, *map(ord, "   ")]
    assert whole(draw("M", "777")) == key(11, *floor, *air, *air)


def test_a_monster_replaces_the_tile_at_its_place() -> None:
    """4.8 and 4.5 round to 5, 4.4 to 4; of two monsters in one tile, the first in the list is shown."""
    blank, row = ord(" "), (ord(" "),) * 5
    for x, place in ((4.8, 4), (4.5, 4), (4.4, 3)):
        middle = [blank] * 5
        middle[place] = SPRITE + GOOMBA
        monsters = [(GOOMBA, x, 7.0, 0.0, 0.0), (MUSHROOM, x, 7.0, 0.0, 0.0)]
        assert whole(draw(at=(3.5, 7.5), monsters=monsters)) == key(11, *row, *middle, *row)


def test_parts_tell_place_occupant_and_relative_speed() -> None:
    """A tile moves at minus Mario's speed, a monster at the difference of speeds; rounded, halves upwards."""
    monsters = [(GOOMBA, 4.0, 7.0, -0.75, 2.0)]
    keys = parts(draw(at=(3.5, 7.5), monsters=monsters, speed=(1.25, -0.5)))
    assert keys[0] == key(12, 0, ord(" "), -1, 1)  # -1.25 and 0.5
    assert keys[8] == key(12, 8, SPRITE + GOOMBA, -2, 3)  # -2 and 2.5
    assert len(set(keys)) == WINDOW


def objects_key(observation: Observation) -> int:
    return int(all_objects(cast(Scene, watched(observation).scene[0])))


def test_the_state_of_all_objects_row_by_row() -> None:
    """Big Mario, a wall to his right, a brick above; two threats, and a monster too far away to be one."""
    screen = draw(
        " b",
        "$ ?",
        "  $",
        " M7",
        "777 77",
        mario=10,
        monsters=[
            (GOOMBA, 3.5, 1.0, -0.5, 0.0),
            (GOOMBA, 15.0, 1.0, 0.0, 0.0),
            (MUSHROOM, 1.0, 2.0, 0.0, 1.0),
        ],
    )
    nothing = -(2**31)
    threats = (GOOMBA, 4, 0, 2, MUSHROOM, -1, 2, 1)
    coin, question, pit = (1, 1), (1, 2), (2, 0)
    expected = key(13, 10, ord("7"), ord("b"), *threats, nothing, *coin, *question, *pit)
    assert objects_key(screen) == expected


def test_what_is_not_there_is_a_symbol_of_its_own() -> None:
    nothing = -(2**31)
    expected = key(13, 0, ord(" "), ord(" "), nothing, nothing, nothing, nothing)
    assert objects_key(draw("M", "77")) == expected


def test_distances_are_to_the_nearest() -> None:
    near = objects_key(draw("  $", "", " M$", "777"))
    assert near == objects_key(draw("$", "", " M$", "777"))
    assert near != objects_key(draw("  $", "", " M", "777"))
