"""The archive of the agent `best`: the better way to a cell, the nearest step, saving as arrays."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from agents.mario.best import Archive, Trajectory
from glue.errors import SaveError
from glue.saves import Saved

SMALL, BIG = 0, 10


def an_archive() -> Archive:
    """Two cells, one of them used three times, and a best episode of three steps."""
    archive = Archive()
    archive.note(SMALL, (3.5, 2.5), -0.5, bytearray([8, 9]))
    archive.note(BIG, (3.5, 2.5), 1.5, bytearray([11]))
    archive.cells[(3, 1, BIG)].tries = 3
    archive.best = Trajectory(bytes([1, 2, 11]), np.array([[0.0, 2.0], [1.0, 2.0], [1.5, 5.0]]), 99.5)
    archive.finished = True
    return archive


def test_of_two_ways_to_a_cell_the_one_of_greater_return_is_kept() -> None:
    archive = Archive()
    actions = bytearray([4, 4, 4])
    archive.note(SMALL, (7.2, 3.9), 1.0, actions)
    actions.append(5)
    archive.note(SMALL, (7.9, 2.0), 1.0, actions)
    (cell,) = archive.cells.values()
    assert (cell.actions, cell.value, cell.place) == (bytes([4, 4, 4]), 1.0, (7.2, 3.9))
    cell.tries = 9
    archive.note(SMALL, (7.9, 2.0), 1.25, actions)
    (cell,) = archive.cells.values()
    assert (cell.actions, cell.value, cell.place, cell.tries) == (bytes([4, 4, 4, 5]), 1.25, (7.9, 2.0), 0)


@pytest.mark.parametrize(("kind", "place"), [(BIG, (7.2, 3.9)), (SMALL, (8.0, 3.9)), (SMALL, (7.2, 4.0))])
def test_another_kind_column_or_pair_of_rows_is_another_cell(kind: int, place: tuple[float, float]) -> None:
    archive = Archive()
    archive.note(SMALL, (7.2, 3.9), 1.0, bytearray([4]))
    archive.note(kind, place, 0.0, bytearray([5]))
    assert [cell.value for cell in archive.cells.values()] == [1.0, 0.0]


def test_left_of_the_first_column_and_below_the_ground_are_cells_of_their_own() -> None:
    archive = Archive()
    archive.note(SMALL, (0.5, 0.5), 0.0, bytearray())
    archive.note(SMALL, (-0.5, 0.5), 0.0, bytearray())
    archive.note(SMALL, (0.5, -0.5), 0.0, bytearray())
    assert len(archive.cells) == 3


def test_nearest_step_is_by_the_sum_of_both_distances() -> None:
    path = Trajectory(bytes(3), np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 4.0]]), 0.0)
    assert [path.nearest(place) for place in [(0.9, 0.0), (1.1, 0.0), (2.0, 2.1)]] == [0, 1, 2]
    assert path.place(2) == (2.0, 4.0)


@pytest.mark.parametrize(
    ("name", "array"),
    [
        ("keys", np.zeros(5, np.int64)),
        ("keys", np.zeros(9, np.int64)),
        ("keys", np.zeros(6)),
        ("values", np.array([0.0, np.nan])),
        ("values", np.zeros(1)),
        ("places", np.zeros(3)),
        ("tries", np.array([0, -1])),
        ("lengths", np.array([1, 1])),
        ("lengths", np.array([4, -1])),
        ("lengths", np.array([2**40, 1])),
        ("actions", np.array([8, 9, 12], np.int8)),
        ("actions", np.array([8, 9, -1], np.int8)),
        ("best_actions", np.zeros(2, np.int8)),
        ("best_places", np.zeros(4)),
        ("best_return", np.array([np.inf])),
        ("best_return", np.zeros(0)),
        ("finished", np.zeros(0, np.int8)),
        ("finished", None),
    ],
)
def test_arrays_that_no_archive_has_are_refused(name: str, array: Any) -> None:
    arrays = dict(an_archive().arrays())
    if array is None:
        del arrays[name]
    else:
        arrays[name] = array
    with pytest.raises(SaveError, match="saved best"):
        Archive.of(Saved("best", {}, {}, arrays))
