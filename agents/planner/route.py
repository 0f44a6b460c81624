"""Routes: plans from the beginning of a known level to its goal, made between episodes.

The search for the plan that earns the most goes through the whole level from left to right. States are
grouped into cells by rough position, size and motion; the best few of a cell are expanded. So a state
competes only with states that have about the same prospects: neither with those that are ahead, nor with
those that are about to fall.
"""

from __future__ import annotations

import zlib
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from agents.planner.search import DESCRIBED, describe, meet, model, push, sink
from glue.compiled.jit import announce_compilation, entry, jit
from glue.compiled.records import Array, Int, Real, layout
from glue.saves import Arrays, Saved

_NOTHING: Final = -1e18
_STEP_COST: Final = 0.01  # items

_step = model.step
_save = model.save
_load = model.load

_ACTIONS: Final = 12
_LAST: Final = 9  # run right: all plans leave the same buttons pressed, which count in the next episode
_STEPS_PER_STATE: Final = 300_000  # approximate model steps for each state that a cell keeps
_ROWS_PER_STATE: Final = 2_000  # maximum number of worlds that wait to be expanded
_LONGEST: Final = 600  # steps
_SLICE: Final = 8  # pixels
_TILE: Final = 16
_ROWS: Final = 15
_FAST: Final = np.float32(6)  # pixels a tick
_CELLS: Final = _ROWS * 3 * 3 * 2  # of a slice: row, size, speed, and whether Mario can jump


class Route:
    """The best route of a level, and the route being tried.

    Args:
        sims: model steps for planning at the beginning of an episode; 0 to make no routes.

    Attributes:
        best: actions of the best episode so far, by number.
        earned: its rewards except the last; `_NOTHING` before an episode has reached the goal.
        tried: checksums of the known part of the level in each search so far.
    """

    def __init__(self, sims: int) -> None:
        self._sims = sims
        self._world, _ = model.make()
        self.forget()

    def forget(self) -> None:
        """Forget the level."""
        self.best: list[int] = []
        self.earned: float = _NOTHING
        self.tried: list[int] = []
        self._plan: list[int] = []
        self._made: list[int] = []
        self._total = 0.0

    def begin(self, worlds: Array, levels: Array, end: int) -> None:
        """Choose a route for an episode: a new one, if it promises more than the best so far.

        Args:
            worlds, levels: the belief after the first observation, shape (1,) each.
            end: number of columns seen.
        """
        self._made, self._plan, self._total = [], [], 0.0
        if not (self._sims and levels["exit_x"][0] < end):
            return
        if self._promised(self.best, worlds, levels) == _NOTHING:
            # The best episode began with other buttons pressed, left so by the episode before it.
            self.best, self.earned, self.tried = [], _NOTHING, []
        self._plan = self.best
        knowledge = zlib.crc32(levels["tiles"][0, :end].tobytes() + levels["spawns"][0, :end].tobytes())
        if knowledge not in self.tried:
            self.tried.append(knowledge)
            with announce_compilation("the routes of the planner"):
                plan = _plan_whole(worlds, levels, end, self._sims)
            if self._promised(plan, worlds, levels) > self.earned:
                self._plan = plan

    def action(self, worlds: Array, levels: Array) -> int:
        """Return the next action of the route; -1 if none leads to the goal from the belief."""
        # The last action wins, but the game may notice the end later.
        rest = self._plan[len(self._made) :] or self._plan[-1:]
        if self._promised(rest, worlds, levels) == _NOTHING:
            self._plan = rest = []
        return rest[0] if rest else -1

    def note(self, action: int, reward: float) -> None:
        """Record an action of the episode, and the reward before it."""
        self._made.append(action)
        self._total += reward

    def finish(self, won: bool) -> None:
        """Keep the episode if it is the best."""
        if self._sims and won and self._total > self.earned:
            self.best, self.earned = self._made, self._total

    def saved(self) -> Arrays:
        """Return the arrays of a saved route; none without the option."""
        if not self._sims:
            return {}
        return {
            "route": np.array(self.best, np.int8),
            "earned": np.array([self.earned]),
            "tried": np.array(self.tried, np.int64),
        }

    def restore(self, saved: Saved) -> None:
        """Continue with the arrays that `saved` returned.

        Raises:
            SaveError: `saved` is damaged.
        """
        if self._sims and "route" in saved.arrays:
            self.best = saved.array("route", np.int8, 0, len(model.ACTIONS) - 1).tolist()
            self.earned = float(saved.array("earned", np.float64).sum())
            self.tried = saved.array("tried", np.int64).tolist()

    def _promised(self, plan: list[int], worlds: Array, levels: Array) -> float:
        """Return a plan's items from a belief on, less its steps; `_NOTHING` if it never reaches the goal."""
        world = self._world[0]
        self._world.view(np.uint8)[:] = worlds.view(np.uint8)
        for step, action in enumerate(plan):
            alive = model.step(self._world, levels, action)
            if world["win_timer"] > 0:
                return float(world["coins"] + world["kills"]) - _STEP_COST * step
            if not alive:
                break
        return _NOTHING


class State:
    """A state that a plan leads to."""

    parent: Int  # -1 for the first
    action: Int
    depth: Int  # steps
    key: Real  # its worth: items, less the cost of the steps
    row: Int  # of its world, until it is expanded


STATE: Final = layout(State)


def _plan_whole(worlds: Array, levels: Array, columns: int, sims: int) -> list[int]:
    """Plan from a belief, shape (1,) each, to the goal; return the actions, none if no way was found.

    Args:
        worlds, levels: the belief; it is not changed.
        columns: number of known columns.
        sims: maximum model steps; each takes about 50 bytes of memory.
    """
    kept = max(sims // _STEPS_PER_STATE, 2)
    rows = kept * _ROWS_PER_STATE
    slices = columns * _TILE // _SLICE
    world = worlds.copy()
    plan = np.full(_LONGEST + 1, -1, np.int64)
    _search(
        world,
        levels,
        world.view(np.uint8),
        np.zeros((rows, model.row_size(columns)), np.uint8),
        columns,
        sims,
        np.zeros(rows + sims // _ACTIONS + 1, STATE),
        np.zeros((slices * _CELLS, kept), np.int64),
        np.zeros(1 << (2 * sims).bit_length(), np.uint64),
        plan,
    )
    return [int(action) for action in plan[plan >= 0]]


@entry
def _search(
    worlds: Array,
    levels: Array,
    memory: npt.NDArray[np.uint8],
    rows: npt.NDArray[np.uint8],
    columns: int,
    sims: int,
    states: Array,
    cells: npt.NDArray[np.int64],
    table: npt.NDArray[np.uint64],
    plan: npt.NDArray[np.int64],
) -> None:
    """Plan.

    Args:
        worlds, memory: the world to begin in, shape (1,), and its bytes; it is changed.
        levels: the level, shape (1,).
        rows: room for R worlds, shape (R, bytes).
        columns: number of known columns.
        sims: maximum model steps.
        states: all zeros, shape (R + sims / 12,).
        cells: room for the numbers of the states in each cell, of which the first is the worst, shape
            (slices * cells of a slice, K).
        table: all zeros, a power of two above 2 * sims.
        plan: -1 throughout; receives the actions.
    """
    world: Any = worlds[0]
    numbers = np.zeros(DESCRIBED + 3, np.int64)
    sizes = np.zeros(len(cells), np.int64)
    room = np.full(len(cells), cells.shape[1])  # states that may still be expanded in each cell
    free = np.arange(len(rows))[::-1].copy()
    spare = len(free) - 1  # number of free rows; the first state has the last row
    batch = np.zeros(_CELLS * cells.shape[1], np.int64)
    _save(worlds, memory, rows[free[spare]], 0, columns)
    states[0].parent = -1
    states[0].row = free[spare]
    count = 1
    here = _cell_of(world, len(cells))
    cells[here, 0] = 0
    sizes[here] = 1
    here //= _CELLS
    used = 0
    best, best_state = -1e18, -1
    while here < len(cells) // _CELLS and used < sims:
        found = 0
        for cell in range(here * _CELLS, (here + 1) * _CELLS):
            for i in range(sizes[cell]):
                batch[found] = cells[cell, i]
                found += 1
            room[cell] -= sizes[cell]
            sizes[cell] = 0
        if found == 0:
            here += 1
            continue
        following = here
        order = np.argsort(-states[batch[:found]]["key"])
        for number in batch[order]:
            state = states[number]
            for action in range(_ACTIONS):
                if state.depth >= _LONGEST or used >= sims:
                    break
                _load(worlds, memory, rows[state.row], 0, columns)
                alive = _step(worlds, levels, action)
                used += 1
                if world.win_timer > 0:
                    if state.key > best and action == _LAST:  # the earnings of the last step are not paid
                        best, best_state = state.key, number
                    continue
                if not alive or world.death_timer > 0 or world.actors[0].y > np.float32(239):
                    continue
                worth = world.coins + world.kills - _STEP_COST * (state.depth + 1)
                cell = _cell_of(world, len(cells))
                is_full = sizes[cell] >= room[cell]
                if room[cell] == 0 or (is_full and states[cells[cell, 0]].key >= worth):
                    continue
                describe(world, numbers)
                numbers[DESCRIBED] = world.fire
                numbers[DESCRIBED + 1] = world.listed
                numbers[DESCRIBED + 2] = world.change_timer
                if meet(table, numbers):
                    continue
                if is_full:
                    new = int(cells[cell, 0])
                elif spare > 0:
                    new = count
                    count += 1
                    spare -= 1
                    states[new].row = free[spare]
                else:
                    continue
                states[new].parent = number
                states[new].action = action
                states[new].depth = state.depth + 1
                states[new].key = worth
                if is_full:
                    sink(states, cells[cell], sizes[cell])
                else:
                    sizes[cell] = push(states, cells[cell], sizes[cell], new)
                _save(worlds, memory, rows[states[new].row], 0, columns)
                following = min(following, cell // _CELLS)
            free[spare] = state.row
            spare += 1
        here = following
    if best_state >= 0:
        plan[states[best_state].depth] = _LAST
        while states[best_state].parent >= 0:
            plan[states[best_state].depth - 1] = states[best_state].action
            best_state = states[best_state].parent


@jit
def _cell_of(world: Any, cells: int) -> int:
    mario = world.actors[0]
    part = min(int(mario.x) // _SLICE, cells // _CELLS - 1)
    row = min(max(int(mario.y) // _TILE, 0), _ROWS - 1)
    size = int(world.large) + int(world.fire)
    speed = 0 if mario.vx < np.float32(0) else (1 if mario.vx < _FAST else 2)
    return int((((part * _ROWS + row) * 3 + size) * 3 + speed) * 2 + int(mario.grounded or world.may_jump))
