"""Draws levels as text pictures at random: ground with gaps and steps, pipes, walls, blocks, monsters.

Many cannot be finished: a gap may be too wide, and a wall too high.
"""

from __future__ import annotations

import numpy as np

ROWS = 15
_MONSTERS = "gkrygGKRY"
_BLOCKS = "SSCUQ?o"


def draw_picture(rng: np.random.Generator, columns: int = 80) -> str:
    """Return a picture in the notation of the Mario AI Framework."""
    cells = np.full((ROWS, columns), "-")
    floor = int(rng.integers(11, 15))
    cells[floor:] = "X"
    column = 12
    while column < columns - 12:
        width = int(rng.integers(3, 12))
        here = slice(column, min(column + width, columns - 10))
        match int(rng.integers(7)):
            case 0:
                cells[:, here.start : here.start + int(rng.integers(2, 9))] = "-"
            case 1:
                floor = int(rng.integers(max(floor - 4, 8), 15))
                cells[:, here.start :] = "-"
                cells[floor:, here.start :] = "X"
            case 2:
                cells[floor - int(rng.integers(1, 6)) : floor, here.start] = "#"
            case 3:
                top = floor - int(rng.integers(2, 5))
                cells[top:floor, here.start : here.start + 2] = "T" if rng.integers(2) else "t"
            case 4:
                cells[floor - int(rng.integers(3, 6)), here] = "%"
            case 5:
                cells[floor - 4, here] = rng.choice([*_BLOCKS], here.stop - here.start)
            case _:
                cells[floor - 1, here.start :: 4][: width // 4 + 1] = rng.choice([*_MONSTERS])
        column += width + 2
    cells[floor - 1, columns - 8] = "F"
    cells[floor - 1, columns - 7 :] = "-"
    return "\n".join(map("".join, cells)) + "\n"
