"""The memory of the agent `best` for one world: its ways to places, and its best episode.

A place is a cell: a column of tiles, a pair of rows, and Mario's kind (small, big, fiery). For every
cell the archive keeps the actions that led to it with the highest return. In a deterministic task they
are the way back, and their return is exactly the best known value of reaching the cell.
Source: Ecoffet, Huizinga, Lehman, Stanley and Clune (2021), First return, then explore.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final, Self

import numpy as np
import numpy.typing as npt

from agents.mario.agent import NUM_ACTIONS
from glue.errors import SaveError
from glue.saves import Arrays, Saved

MAX_STEPS: Final = 4096
"""Maximum number of steps of an episode that are remembered."""
_MAX_CELLS: Final = 16384
_ROWS: Final = 2

Position = tuple[float, float]
"""Mario's x and y, in tiles."""


@dataclass(slots=True)
class Cell:
    """A way to a cell: its actions, their return, the place where they end, and the number of their uses."""

    actions: bytes
    value: float
    place: Position
    tries: int = 0


class Trajectory:
    """A whole episode.

    Args:
        actions: the numbers of its N actions.
        places: Mario's place before each of them, shape (N, 2), in tiles.
        episode_return: the sum of its rewards.
    """

    def __init__(self, actions: bytes, places: npt.NDArray[np.float64], episode_return: float) -> None:
        self.actions = actions
        self.places = places
        self.episode_return = episode_return

    def __len__(self) -> int:
        return len(self.actions)

    def place(self, step: int) -> Position:
        """Return Mario's place before the action of a step."""
        x, y = self.places[step].tolist()
        return x, y

    def nearest(self, place: Position) -> int:
        """Return the step whose place is nearest, by the sum of both distances."""
        return int(np.abs(self.places - place).sum(axis=1).argmin())


class Archive:
    """The cells of a world, the best episode in it, and whether any episode has ended with a reward."""

    def __init__(self) -> None:
        self.cells: dict[tuple[int, int, int], Cell] = {}
        self.best: Trajectory | None = None
        self.finished = False

    def note(self, kind: int, place: Position, value: float, actions: bytearray) -> None:
        """Remember the way by which Mario, of this kind, reached a place, unless a better one is known."""
        x, y = place
        key = (math.floor(x), math.floor(y / _ROWS), kind)
        cell = self.cells.get(key)
        if cell is None:
            if len(self.cells) == _MAX_CELLS:
                return
        elif value <= cell.value:
            return
        self.cells[key] = Cell(bytes(actions), value, place)

    def arrays(self) -> Arrays:
        """Return everything as arrays for saving."""
        cells = list(self.cells.values())
        best = self.best or Trajectory(b"", np.empty((0, 2)), 0.0)
        return {
            "keys": np.array(list(self.cells), np.int64).reshape(-1),
            "values": np.array([cell.value for cell in cells]),
            "places": np.array([cell.place for cell in cells]).reshape(-1),
            "tries": np.array([cell.tries for cell in cells], np.int64),
            "lengths": np.array([len(cell.actions) for cell in cells], np.int64),
            "actions": np.frombuffer(b"".join(cell.actions for cell in cells), np.int8),
            "best_actions": np.frombuffer(best.actions, np.int8),
            "best_places": best.places.reshape(-1),
            "best_return": np.array([best.episode_return]),
            "finished": np.array([self.finished], np.int8),
        }

    @classmethod
    def of(cls, saved: Saved) -> Self:
        """Return the archive whose `arrays` were saved.

        Raises:
            SaveError: `saved` cannot come from `arrays`.
        """
        archive = cls()
        keys = _rows(saved, "keys", np.int64, 3).tolist()
        values = saved.array("values", np.float64).tolist()
        places = _rows(saved, "places", np.float64, 2).tolist()
        tries = saved.array("tries", np.int64, low=0).tolist()
        lengths = saved.array("lengths", np.int64, low=0, high=MAX_STEPS)
        actions = saved.array("actions", np.int8, low=0, high=NUM_ACTIONS - 1).tobytes()
        if not len(keys) == len(values) == len(places) == len(tries) == len(lengths) <= _MAX_CELLS:
            raise SaveError(f"saved {saved.player}: its cells must be {_MAX_CELLS} at most, each complete")
        if lengths.sum() != len(actions):
            raise SaveError(
                f"saved {saved.player}: {len(actions)} actions for {lengths.sum()} steps to cells"
            )
        ways = _split(actions, lengths.tolist())
        for key, way, value, place, used in zip(keys, ways, values, places, tries, strict=True):
            archive.cells[tuple(key)] = Cell(way, value, tuple(place), used)
        best = saved.array("best_actions", np.int8, low=0, high=NUM_ACTIONS - 1)
        best_places = _rows(saved, "best_places", np.float64, 2)
        if len(best) != len(best_places) or len(best) > MAX_STEPS:
            raise SaveError(f"saved {saved.player}: {len(best)} actions at {len(best_places)} places")
        best_return, finished = saved.array("best_return", np.float64), saved.array("finished", np.int8)
        if len(best_return) != 1 or len(finished) != 1:
            raise SaveError(f"saved {saved.player}: one best return and one flag for the finish are needed")
        if len(best):
            archive.best = Trajectory(best.tobytes(), best_places, float(best_return[0]))
        archive.finished = bool(finished[0])
        return archive


def _rows(saved: Saved, name: str, dtype: type[np.generic], width: int) -> npt.NDArray[Any]:
    """Return an array of rows of `width` numbers."""
    array = saved.array(name, dtype, low=-(2.0**62), high=2.0**62)
    if len(array) % width:
        raise SaveError(f"saved {saved.player}: {name!r} must be rows of {width} numbers, not {len(array)}")
    return array.reshape(-1, width)


def _split(actions: bytes, lengths: list[int]) -> Iterator[bytes]:
    start = 0
    for length in lengths:
        yield actions[start : start + length]
        start += length
