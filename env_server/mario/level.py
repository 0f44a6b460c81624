"""A level as data, as the generator makes it and recordings hold it."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import zip_longest
from typing import Any, NamedTuple


class Spawn(NamedTuple):
    """A spawn point of an enemy; `kind` is 0 red koopa, 1 green koopa, 2 goomba, 3 spiky, 4 piranha plant."""

    column: int
    row: int
    kind: int
    winged: bool


class Level(NamedTuple):
    """A level, as it is when an episode begins.

    Attributes:
        columns: width in tiles.
        goal: the column to pass, and the row of the ground there.
        rows: the tiles, highest row first; two hexadecimal digits per tile.
        spawns: by column, then row.
    """

    columns: int
    goal: tuple[int, int]
    rows: tuple[str, ...]
    spawns: tuple[Spawn, ...]


def level_difference(expected: Level, got: Level) -> str:
    """Return the first difference between two levels, in words; "" if there is none."""
    for what, old, new in _pairs(expected, got):
        if old != new:
            return f"the level's {what}: expected {old!r}, got {new!r}"
    return ""


def _pairs(expected: Level, got: Level) -> Iterator[tuple[str, Any, Any]]:
    """Yield every part of two levels by name; if only one level has a part, the other value is None."""
    yield "width", expected.columns, got.columns
    yield "goal", expected.goal, got.goal
    for row, tiles in enumerate(zip_longest(expected.rows, got.rows, fillvalue="")):
        for column, (old, new) in enumerate(zip_longest(*map(_codes, tiles))):
            yield f"tile in column {column}, row {row}", old, new
    for number, (spawn, ours) in enumerate(zip_longest(expected.spawns, got.spawns)):
        yield f"spawn point {number}", spawn, ours


def _codes(row: str) -> list[str]:
    return [row[i : i + 2] for i in range(0, len(row), 2)]
