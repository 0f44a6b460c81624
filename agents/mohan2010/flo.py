"""Functional-level operators (FLO): a task tied to one object, made of several keystrokes.

A keystroke-level operator (KLO) is a primitive action, held for one step, inside an FLO.

An FLO is proposed for every object whose relation to Mario holds, and ends when it no longer holds;
move-to-goal is always proposed. Proposals to which no other is preferred are kept.
Source: Mohan (2010), section 6; endings and goals from the author's Soar agents.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from agents.mario.agent import RIGHT, action_number
from agents.mario.objects import A_COIN, A_MONSTER, A_PIT, A_QUESTION, Object, Scene
from agents.mario.observation import COIN, OUTSIDE, PIPE, QUESTION, ROWS, SOLID, Screen, tile
from agents.sarsa import extend, feature
from glue.compiled.jit import jit

Numbers = npt.NDArray[np.int64]

TACKLE_MONSTER: Final = A_MONSTER
SEARCH_QUESTION: Final = A_QUESTION
GRAB_COIN: Final = A_COIN
AVOID_PIT: Final = A_PIT
MOVE_TO_GOAL: Final = 4
NONE: Final = -1

PROGRAMMED: Final = (1, 2, 3, 0)
"""Rank of each FLO, 0 the most preferred: avoid-pit, tackle-monster, search-question, grab-coin."""
LEARNED: Final = (1, 1, 1, 0)
"""Only avoid-pit is preferred; learned values choose among the other three."""

KLO_LEVEL: Final = 1
FLO_LEVEL: Final = 2
CONTEXT: Final = 3

_BEHIND: Final = 3

_number: Final = jit(action_number)


@jit
def is_learned(flo: int) -> bool:
    """Return whether the keystrokes of an FLO, and the choice of it, are learned."""
    return flo in (TACKLE_MONSTER, SEARCH_QUESTION, GRAB_COIN)


@jit
def keep_preferred(scene: Scene, ranks: Numbers, kept: Numbers) -> int:
    """Fill in `kept` with the objects whose FLO is proposed and ranks best; return how many.

    If there is none, only move-to-goal is left.
    """
    best = len(ranks)
    count = 0
    for i in range(scene.count):
        found = scene.objects[i]
        if found.related and ranks[found.kind] <= best:
            if ranks[found.kind] < best:
                best = ranks[found.kind]
                count = 0
            kept[count] = i
            count += 1
    return count


@jit
def find(scene: Scene, kept: Numbers, count: int, flo: int, identity: int) -> int:
    """Return the index of the object of `kept` with this id that `flo` deals with, or NONE."""
    for i in range(count):
        found = scene.objects[kept[i]]
        if found.kind == flo and found.id == identity:
            return int(kept[i])
    return NONE


@jit
def describe(level: int, thing: Object) -> np.uint64:
    """Return the key of an object as a level's operators see it: its kind, type, distance and motion."""
    key = extend(feature(level), thing.kind)
    return extend(extend(extend(extend(key, thing.type), thing.dx), thing.dy), thing.motion)


@jit
def context(scene: Scene) -> int:
    """Return as three bits whether there is a threat, a reachable question, a reachable coin."""
    bits = 0
    for i in range(scene.count):
        found = scene.objects[i]
        if found.related and is_learned(found.kind):
            bits |= 1 << found.kind
    return bits


@jit
def goal_reached(scene: Scene, flo: int, identity: int, grid: int) -> bool:
    """Return whether an FLO that has ended reached its goal, with `grid` cells per tile.

    A monster must be gone, or more than three tiles behind; a coin or question must have left its
    place, which must be in view.
    """
    if flo == TACKLE_MONSTER:
        for i in range(scene.count):
            found = scene.objects[i]
            if found.kind == A_MONSTER and found.id == identity:
                return found.dx < -_BEHIND * grid
        return True
    now = tile(scene.screen, identity // ROWS, identity % ROWS)
    return now != OUTSIDE and now != (COIN if flo == GRAB_COIN else QUESTION)


# The policies of the FLOs that learn nothing: background knowledge instead of learned values


@jit
def jump_the_pit() -> int:
    """Return the one KLO of avoid-pit: a running jump to the right crosses it."""
    return _number(RIGHT, True, True)


@jit
def move_right(screen: Screen) -> int:
    """Return the one KLO of move-to-goal: walk to the right, and jump when something is in the way."""
    ahead = tile(screen, screen.column + 1, screen.row)
    return _number(RIGHT, ahead in (SOLID, PIPE), False)
