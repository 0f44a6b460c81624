"""A way to the goal of a completely known level, found by one search of the whole level."""

from __future__ import annotations

from typing import Any, Final

import numpy as np

from agents.planner.search import SETTINGS, STAY, make_room, model, search
from glue.compiled.jit import announce_compilation

_WEIGHT: Final = 1.5


def find_way(world: Any, level: Any, sims: int) -> tuple[list[int], int]:
    """Search for actions that reach the goal, regardless of their cost.

    In the first of two searches, a state is not visited again at another time.

    Args:
        world: the record of a game that has just begun; it is not changed.
        level: the record of its level, all columns of which are known.
        sims: maximum model steps of a search; each takes 4 kB of memory.

    Returns:
        The actions by number, none if no way was found, and the model steps.
    """
    worlds, levels = model.make()
    worlds[0], levels[0] = world, level
    columns = int(levels["columns"][0])
    scratch, _ = model.make()
    settings: Any = np.zeros(1, SETTINGS)
    how = settings[0]
    how["weight"], how["sims"] = _WEIGHT, sims
    how["end"] = how["columns"] = columns
    plan = np.zeros(int(worlds["max_trial_steps"][0]) + 1, np.int64)
    spent = 0
    for hard in (True, False):
        how["hard"] = hard
        plan[:] = -1
        with announce_compilation("the planner"):
            room = make_room(sims, columns)
            length = search(worlds, levels, scratch, scratch.view(np.uint8), *room, settings, plan)
        spent += int(how["used"])
        way: list[int] = plan[:length].tolist()
        scratch[0] = worlds[0]
        for action in way:
            model.step(scratch, levels, action)
        if scratch["win_timer"][0] > 0:
            # The game notices the win when it draws again.
            return way + [STAY] * int(scratch["playing"][0]), spent
    return [], spent
