"""Infinite Mario as a model: the game's own rules, applied to the part of a game that an agent has seen.

Agents find this module in the entry-point group `glue.models`. A belief, like a game, is a world and a level:
arrays of one record, since Python passes an array to compiled code in a tenth of the time that a record
takes. Its level holds the part seen so far, and level ground to the right of it. All functions except `make`,
`constants` and `row_size` are compiled, for compiled code and for Python.

    start, correct  begin an episode with its first observation; correct the belief by later ones
    predicts        compare a belief with an observation
    finds           compare only Mario's position
    rewind          begin an episode on the level as it is believed to be, without an observation
    place           move only Mario to his observed position
    step            carry out an action
    change          set other physical constants
    save, load      copy a world to a row of bytes, and back: a node of a search

No observation shows the jump counter, the timers or the contents of blocks. A belief carries them from step
to step, and they are overwritten only where a prediction proves wrong.
"""

from __future__ import annotations

from dataclasses import asdict
from typing import Final

import numpy as np
import numpy.typing as npt

from env_server.mario import belief
from env_server.mario.observation import BODY_SIZE as BODY_SIZE
from env_server.mario.parameters import resolve
from env_server.mario.sim import step as rules
from env_server.mario.sim.state import COLUMNS as COLUMNS
from env_server.mario.sim.state import FREE, Levels, Worlds
from env_server.mario.sim.state import LEVEL as LEVEL
from env_server.mario.sim.state import WORLD as WORLD
from glue.compiled.jit import entry, jit

ACTIONS: Final = np.array(
    [(direction, jump, run) for direction in (-1, 0, 1) for jump in (0, 1) for run in (0, 1)], np.int64
)
"""Direction, jump and run of each action, shape (12, 3)."""

CONSTANTS: Final = ("speed_walk", "speed_run", "speed_jump", "accel_fall", "speed_slidejump", "jump_time")
"""The physical constants in which published tasks differ; units and ranges are those of the parameters."""

_KEPT: Final = 48  # maximum number of actors of a saved world; of more, the oldest are left out

# The layout of a saved world: all numbers, the length of the list, the actors in the order of the list,
# Mario first, and the changes in some columns.
_OFFSETS: Final = {name: WORLD.fields[name][1] for name in WORLD.fields} if WORLD.fields else {}
_ACTORS_AT: Final = _OFFSETS["actors"]
_NUMBERS_AT: Final = _OFFSETS["level_seed"]
_NUMBERS: Final = _OFFSETS["changed"] - _NUMBERS_AT
_ACTOR_SIZE: Final = 40
_LISTED_AT: Final = -(-_NUMBERS // 8) * 8
_LIST_AT: Final = _LISTED_AT + 8
_WINDOW_AT: Final = -(-(_LIST_AT + _ACTOR_SIZE * (_KEPT + 1)) // 8) * 8
Bytes = npt.NDArray[np.uint8]
Reals = npt.NDArray[np.float64]


def make(**parameters: int | float | str) -> tuple[Worlds, Levels]:
    """Return a belief, arrays of one world and one level; `parameters` override those of instance 0."""
    worlds, levels = np.zeros(1, WORLD), np.zeros(1, LEVEL)
    resolve(parameters).write_to(worlds[0])
    levels["columns"] = COLUMNS
    return worlds, levels


def constants(**parameters: float) -> Reals:
    """Return the values of `CONSTANTS`, shape (6,); `parameters` override those of instance 0."""
    task = asdict(resolve(parameters))
    return np.array([task[name] for name in CONSTANTS], np.float64)


@entry
def start(worlds: Worlds, levels: Levels, seen: npt.NDArray[np.int64], body: Bytes) -> int:
    """Begin an episode with its first observation; return how many tiles differ from those seen before.

    Args:
        worlds, levels: the belief. The level keeps its columns before `seen[0]`.
        seen: number of columns of the level that have been seen, shape (1,).
        body: the observation as the body of an abstract type, and room up to BODY_SIZE bytes.
    """
    return belief.start(worlds[0], levels[0], seen, body)


@entry
def predicts(worlds: Worlds, levels: Levels, body: Bytes) -> bool:
    """Return whether Mario and all other actors match an observation to the last bit."""
    return belief.predicts(worlds[0], levels[0], body)


@entry
def finds(worlds: Worlds, body: Bytes) -> bool:
    """Return whether Mario's position matches an observation to the last bit."""
    return belief.finds(worlds[0], body)


@entry
def correct(worlds: Worlds, levels: Levels, seen: npt.NDArray[np.int64], body: Bytes) -> bool:
    """Correct the belief by an observation; return whether it matched already, apart from new columns.

    Args: as for `start`.
    """
    return belief.correct(worlds[0], levels[0], seen, body)


@entry
def place(worlds: Worlds, levels: Levels, body: Bytes) -> None:
    """Move Mario to his observed position; everything else stays as predicted."""
    belief.place(worlds[0], levels[0], body)


@entry
def rewind(worlds: Worlds, levels: Levels) -> None:
    """Begin an episode on the level as it is."""
    rules.rewind(worlds[0], levels[0])


@entry
def change(worlds: Worlds, values: Reals) -> None:
    """Set the `CONSTANTS` of a world to `values`, shape (6,)."""
    world = worlds[0]
    world.speed_walk = values[0]
    world.speed_run = values[1]
    world.speed_jump = values[2]
    world.accel_fall = values[3]
    world.speed_slidejump = values[4]
    world.jump_time = int(values[5])


@entry
def step(worlds: Worlds, levels: Levels, action: int) -> bool:
    """Carry out an action, by its number; return False if the episode ended."""
    return rules.act(worlds[0], levels[0], action // 4 - 1, action // 2 % 2, action % 2)


def row_size(columns: int) -> int:
    """Return the size of a saved world of `columns` columns in bytes, a multiple of 64."""
    return -(-(_WINDOW_AT + 4 * columns) // 64) * 64


@entry
def save(worlds: Worlds, memory: Bytes, row: Bytes, first: int, columns: int) -> None:
    """Copy a world to `row`.

    Args:
        worlds: the world.
        memory: its bytes, shape (WORLD.itemsize,).
        row: at least `row_size(columns)` bytes, the first at a multiple of 8.
        first, columns: the columns that play may have changed since the earliest of the worlds that are
            loaded in turn; the same in every call for these worlds.
    """
    world = worlds[0]
    _copy(memory, _NUMBERS_AT, row, 0, _NUMBERS)
    listed = min(world.listed, _KEPT)
    carrying = 0
    _copy(memory, _ACTORS_AT, row, _LIST_AT, _ACTOR_SIZE)
    for i in range(listed):
        slot = world.order[i]
        if slot == world.carrying:
            carrying = i + 1
        _copy(memory, _ACTORS_AT + _ACTOR_SIZE * slot, row, _LIST_AT + _ACTOR_SIZE * (i + 1), _ACTOR_SIZE)
    words = row.view(np.int32)
    words[_LISTED_AT // 4] = listed
    words[_LISTED_AT // 4 + 1] = carrying
    halves = row.view(np.uint16)[_WINDOW_AT // 2 :]
    for i in range(columns):
        halves[i] = world.changed[first + i]
        halves[columns + i] = world.dead[first + i]


@entry
def load(worlds: Worlds, memory: Bytes, row: Bytes, first: int, columns: int) -> None:
    """Copy a world back from `row`. Args: as for `save`."""
    world = worlds[0]
    for i in range(world.listed):
        world.actors[world.order[i]].kind = FREE
    _copy(row, 0, memory, _NUMBERS_AT, _NUMBERS)
    words = row.view(np.int32)
    listed = words[_LISTED_AT // 4]
    world.listed = listed
    world.added = 0
    _copy(row, _LIST_AT, memory, _ACTORS_AT, _ACTOR_SIZE * (listed + 1))
    for i in range(listed):
        world.order[i] = i + 1
    world.carrying = words[_LISTED_AT // 4 + 1]
    halves = row.view(np.uint16)[_WINDOW_AT // 2 :]
    for i in range(columns):
        world.changed[first + i] = halves[i]
        world.dead[first + i] = halves[columns + i]


@jit
def _copy(source: Bytes, begin: int, target: Bytes, at: int, count: int) -> None:
    for i in range(count):
        target[at + i] = source[begin + i]
