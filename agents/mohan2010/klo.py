"""Keystroke-level operators (KLO): a primitive action, held for one step, inside an FLO.

A KLO is identified by the number of its action; see `agents.mario.actions`. The two functions are the
policies of the unlearned FLOs: background knowledge instead of learned values.
Source: Mohan (2010), section 6.
"""

from __future__ import annotations

from typing import Final

from agents.mario.actions import NUM_ACTIONS, RIGHT, action_number
from agents.mario.observation import PIPE, SOLID, Screen, tile
from glue.compiled.jit import jit

KLOS: Final = NUM_ACTIONS

_number: Final = jit(action_number)


@jit
def jump_the_pit() -> int:
    """Return the one KLO of avoid-pit: a running jump to the right crosses it."""
    return _number(RIGHT, True, True)


@jit
def move_right(screen: Screen) -> int:
    """Return the one KLO of move-to-goal: walk to the right, and jump when something is in the way."""
    ahead = tile(screen, screen.column + 1, screen.row)
    return _number(RIGHT, ahead in (SOLID, PIPE), False)
