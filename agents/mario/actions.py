"""The primitive actions of Infinite Mario, by number.

An action is a direction, whether to jump and whether to run, held for one step. There are twelve;
Mohan (2010) calls them keystroke-level operators (KLO).
"""

from __future__ import annotations

from typing import Final

from glue.types import Action

LEFT: Final = -1
STAY: Final = 0
RIGHT: Final = 1

NUM_ACTIONS: Final = 12
ACTIONS: Final = tuple(
    Action(ints=(direction, jump, run))
    for direction in (LEFT, STAY, RIGHT)
    for jump in (0, 1)
    for run in (0, 1)
)
"""The ints of each action by its number: direction -1 to 1, jump 0 or 1, run 0 or 1."""


def action_number(direction: int, jump: bool, run: bool) -> int:
    """Return the number of an action, 0 to 11."""
    return 4 * (direction + 1) + 2 * int(jump) + int(run)
