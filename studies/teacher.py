"""A teacher that knows the level, and prices each action by a search from the state after it.

The price of an action is the number of steps until Mario has come a dozen columns further, to a place where
he can stop, with a penalty for not reaching one.
"""

from __future__ import annotations

from typing import Any, Final

import numpy as np
import numpy.typing as npt

from agents.mario.agent import NUM_ACTIONS
from agents.planner.search import BEFORE, SETTINGS, make_room, model, search, stride
from env_server.mario.many.games import Games
from glue.compiled.jit import entry
from glue.compiled.records import Array

_LEFT: Final = 4  # the first actions go left
_SIMS: Final = 200  # model steps to price an action
_WEIGHT: Final = 3.0
_AHEAD: Final = 12  # columns
_WINDOW: Final = 60  # columns that may change during a search
_PLAN: Final = 64
DEATH: Final = 40.0  # steps
_UNSAFE: Final = 25.0  # steps added for a plan after which he cannot stop
_SHORT: Final = 10.0  # steps added for a plan that does not get far enough
_LOSS_OF_SIZE: Final = 2.0
_BACK: Final = 5.0  # steps above the best for going left, where going on is possible
_POSSIBLE: Final = 12.0  # steps: going on is possible by an action that costs less
_UNKNOWN: Final = -1.0

_step = model.step


class Teacher:
    """Prices the actions in N games, and remembers a plan for each."""

    def __init__(self, games: Games) -> None:
        self._games = games
        self._scratch, _ = model.make()
        self._copy, _ = model.make()
        self._room = make_room(_SIMS + 2 * _PLAN, _WINDOW)
        self._settings: Any = np.zeros(1, SETTINGS)
        how = self._settings[0]
        how["sims"], how["weight"], how["size_cost"] = _SIMS, _WEIGHT, 6.0
        self._plan = np.full(_PLAN, -1, np.int64)
        self.plans: npt.NDArray[np.int64] = np.full((len(games), _PLAN), -1, np.int64)

    def prices(self, which: npt.NDArray[np.int64]) -> npt.NDArray[np.float32]:
        """Return the price of each action in some games, in steps, shape (len(which), 12)."""
        games = self._games
        found = np.full((len(which), NUM_ACTIONS), _UNKNOWN, np.float32)
        room = self._room
        _price(
            which,
            games.worlds,
            games.levels,
            games.lanes["place"],
            self._copy,
            self._scratch,
            room.rows,
            room.nodes,
            room.heap,
            room.table,
            self._settings,
            self._plan,
            self.plans,
            found,
        )
        best = np.where(found == _UNKNOWN, np.inf, found).min(1, keepdims=True)
        return np.where(found == _UNKNOWN, best + _BACK, found).astype(np.float32)

    def follow(self, actions: npt.NDArray[np.int64]) -> None:
        """Keep the plans that begin with the actions taken, shape (N,)."""
        kept = self.plans[:, 0] == actions
        self.plans[:, :-1] = self.plans[:, 1:].copy()
        self.plans[~kept] = -1


@entry
def _price(
    which: npt.NDArray[np.int64],
    worlds: Any,
    levels: Any,
    place: npt.NDArray[np.int64],
    copy: Any,
    scratch: Any,
    rows: npt.NDArray[np.uint8],
    nodes: Array,
    heap: npt.NDArray[np.int64],
    table: npt.NDArray[np.uint64],
    settings: Array,
    plan: npt.NDArray[np.int64],
    plans: npt.NDArray[np.int64],
    found: npt.NDArray[np.float32],
) -> None:
    """Write the prices of all actions in some games, and the plan that begins with the cheapest."""
    how: Any = settings[0]
    memory = scratch.view(np.uint8)
    best_plan = np.empty(_PLAN, np.int64)
    for i in range(len(which)):
        game = which[i]
        world: Any = worlds[game]
        level = levels[place[game] : place[game] + 1]
        line = min(int(world.actors[0].x) // 16 + _AHEAD, int(level[0].columns))
        goal = min(16.0 * line - 8.0, 16.0 * level[0].exit_x + 1.0)
        best = np.float32(np.inf)
        best_plan[:] = -1
        for action in range(NUM_ACTIONS - 1, -1, -1):
            expected = plans[game, 0] == action
            if action < _LEFT and not expected and best < _POSSIBLE:
                continue
            copy.view(np.uint8)[:] = worlds[game : game + 1].view(np.uint8)
            alive = _step(copy, level, action)
            after: Any = copy[0]
            price = 1.0
            plan[:] = -1
            if after.win_timer == 0:
                if not alive or after.death_timer > 0 or after.actors[0].y > np.float32(239):
                    found[i, action] = DEATH
                    continue
                first = max(0, int(after.actors[0].x) // 16 - BEFORE)
                how.columns = min(_WINDOW, line - first)
                how.end = level[0].columns
                if expected:
                    plan[:-1] = plans[game, 1:]
                search(copy, level, scratch, memory, rows, nodes, heap, table, settings, plan)
                safe = how.safe
                if not safe and expected:  # a plan that was safe a step ago still is
                    plan[:-1] = plans[game, 1:]
                    safe = True
                k = 0
                while k < _PLAN and plan[k] >= 0 and after.win_timer == 0 and after.death_timer == 0:
                    _step(copy, level, plan[k])
                    price += 1.0
                    k += 1
                if after.death_timer > 0:
                    price = DEATH
                elif not safe:
                    price += _UNSAFE
                elif after.actors[0].x < goal and after.win_timer == 0:
                    price += _SHORT + (goal - after.actors[0].x) / stride(after)
                if world.large and not after.large:
                    price += _LOSS_OF_SIZE
            found[i, action] = price
            if price < best:
                best = np.float32(price)
                best_plan[0] = action
                best_plan[1:] = plan[:-1]
        plans[game] = best_plan
