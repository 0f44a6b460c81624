"""Keystroke-level operators (KLO): the primitive actions, each held for one step.

A KLO is a direction, whether to jump, and whether to run; it is known by its number, 0 to 11.
Source: Mohan (2010), section 6.
"""

from __future__ import annotations

from typing import Final

from agents.mario.observation import PIPE, SOLID, Screen, tile
from glue.compiled.jit import jit
from glue.types import Action

__all__ = ["ACTIONS", "KLOS", "LEFT", "RIGHT", "STAY", "jump_the_pit", "klo", "move_right"]

LEFT: Final = -1
STAY: Final = 0
RIGHT: Final = 1

KLOS: Final = 12
ACTIONS: Final = tuple(
    Action(ints=(direction, jump, run))
    for direction in (LEFT, STAY, RIGHT)
    for jump in (0, 1)
    for run in (0, 1)
)
"""What each KLO sends: direction -1 to 1, jump 0 or 1, run 0 or 1."""


@jit
def klo(direction: int, jump: bool, run: bool) -> int:
    """Return the number of a KLO."""
    return 4 * (direction + 1) + 2 * int(jump) + int(run)


@jit
def jump_the_pit() -> int:
    """Return the one KLO of avoid-pit: background knowledge that a running jump crosses it."""
    return klo(RIGHT, True, True)


@jit
def move_right(screen: Screen) -> int:
    """Return the one KLO of move-to-goal: walk to the right, and jump when something is in the way."""
    ahead = tile(screen, screen.column + 1, screen.row)
    return klo(RIGHT, ahead in (SOLID, PIPE), False)
