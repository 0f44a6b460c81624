"""A route: a plan from the beginning of a known level to its goal, made between episodes by beam search.

Nothing is cut off at the end of the view, so that a plan may go out of its way for a coin. A layer of the
search holds states after a number of steps: of those that differ from each other, the best.
"""

from __future__ import annotations

import zlib
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from agents.planner.search import model
from agents.planner.tree import DESCRIBED, describe, forget, meet, stride
from glue.compiled.jit import announce_compilation, entry
from glue.compiled.records import Array, Int, Real, layout
from glue.saves import Arrays, Saved

_step = model.step
_save = model.save
_load = model.load

_ACTIONS: Final = 12
_LAYERS: Final = 600
_STEPS_PER_STATE: Final = 3000  # model steps that each state of a layer costs, about
_WIDEST: Final = 4000
_WORTH: Final = (100.0, 30.0, 15.0, 60.0)  # steps that an item is worth, in turns
_STEP_COST: Final = 0.01  # items
_NOTHING: Final = -1e18
_AFTERWARDS: Final = 100  # steps for which the search goes on after the first way to the goal


class Candidate:
    """A state of the next layer."""

    parent: Int
    action: Int
    worth: Real


CANDIDATE: Final = layout(Candidate)


class Route:
    """The best route of a level, and the one that is tried.

    Args:
        sims: model steps to plan with at the beginning of an episode; 0 to make no routes.

    Attributes:
        best: actions of the best episode so far, by number.
        earned: its rewards but the last; `_NOTHING` before an episode has reached the goal.
        tried: what was known of the level, and how items were valued, in each search so far.
    """

    def __init__(self, sims: int) -> None:
        self._width = min(max(sims // _STEPS_PER_STATE, 1), _WIDEST) if sims else 0
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
            end: number of columns that were seen.
        """
        self._made, self._plan, self._total = [], [], 0.0
        if not (self._width and levels["exit_x"][0] < end):
            return
        self._plan = list(self.best)
        knowledge = zlib.crc32(levels["tiles"][0, :end].tobytes() + levels["spawns"][0, :end].tobytes())
        for turn, worth in enumerate(_WORTH):
            if (attempt := len(_WORTH) * knowledge + turn) not in self.tried:
                self.tried.append(attempt)
                plan = self._planned(worlds, levels, end, worth)
                if self._promised(plan, worlds, levels) > self.earned:
                    self._plan = plan
                break

    def action(self, worlds: Array, levels: Array) -> int:
        """Return the next action of the route; -1 if there is none that leads to the goal from the belief."""
        at = len(self._made)
        if self._plan and self._promised(self._plan[at:], worlds, levels) == _NOTHING:
            self._plan = []
        return self._plan[at] if self._plan else -1

    def note(self, action: int, reward: float) -> None:
        """Note an action of the episode, and the reward before it."""
        self._made.append(action)
        self._total += reward

    def finish(self, won: bool) -> None:
        """Keep the episode if it is the best."""
        if self._width and won and self._total > self.earned:
            self.best, self.earned = self._made, self._total

    def saved(self) -> Arrays:
        """Return the arrays of a saved route; none without the option."""
        if not self._width:
            return {}
        return {
            "route": np.array(self.best, np.int8),
            "earned": np.array([self.earned]),
            "tried": np.array(self.tried, np.int64),
        }

    def restore(self, saved: Saved) -> None:
        """Continue with what `saved` returned.

        Raises:
            SaveError: it is damaged.
        """
        if self._width and "route" in saved.arrays:
            self.best = saved.array("route", np.int8, 0, _ACTIONS - 1).tolist()
            self.earned = float(saved.array("earned", np.float64).sum())
            self.tried = saved.array("tried", np.int64).tolist()

    def _promised(self, plan: list[int], worlds: Array, levels: Array) -> float:
        """Return the items that a plan earns from a belief on, less its steps; `_NOTHING` without goal."""
        world = self._world[0]
        self._world.view(np.uint8)[:] = worlds.view(np.uint8)
        for step, action in enumerate(plan):
            alive = model.step(world, levels[0], action)
            if world["win_timer"] > 0:
                return float(world["coins"] + world["kills"]) - _STEP_COST * step
            if not alive:
                break
        return _NOTHING

    def _planned(self, worlds: Array, levels: Array, columns: int, worth: float) -> list[int]:
        width = self._width
        self._world.view(np.uint8)[:] = worlds.view(np.uint8)
        plan = np.zeros(_LAYERS + 1, np.int64)
        with announce_compilation("the routes of the planner"):
            length = plan_level(
                self._world,
                levels,
                self._world.view(np.uint8),
                np.zeros((2 * width, model.row_size(columns)), np.uint8),
                columns,
                np.zeros(_ACTIONS * width, CANDIDATE),
                np.zeros(1 << (2 * _ACTIONS * width).bit_length(), np.uint64),
                np.zeros((_LAYERS, width), np.int32),
                np.zeros((_LAYERS, width), np.int8),
                worth,
                plan,
            )
        return [int(action) for action in plan[:length]]


@entry
def plan_level(
    worlds: Array,
    levels: Array,
    memory: npt.NDArray[np.uint8],
    rows: npt.NDArray[np.uint8],
    columns: int,
    candidates: Array,
    table: npt.NDArray[np.uint64],
    parents: npt.NDArray[np.int32],
    actions: npt.NDArray[np.int8],
    item: float,
    plan: npt.NDArray[np.int64],
) -> int:
    """Plan; return the length of the plan, 0 if no way to the goal was found.

    Args:
        worlds, memory: the world to begin in, shape (1,), and its bytes; it is changed.
        levels: the level, shape (1,).
        rows: room for two layers of W worlds, shape (2 * W, bytes).
        columns: number of columns that are known.
        candidates: room for the candidates of a layer, shape (12 * W,).
        table: room for their keys, a power of two above 24 * W.
        parents, actions: the tree, shape (layers, W).
        item: steps that a coin or a kill is worth; being large is worth half of it, and fire as much again.
        plan: takes the actions of the plan, ended by -1.
    """
    level: Any = levels[0]
    world: Any = worlds[0]
    width = parents.shape[1]
    numbers = np.zeros(DESCRIBED + 3, np.int64)
    _save(world, memory, rows[0], 0, columns)
    count = 1
    best, best_layer, best_node, best_action = -1e18, -1, -1, -1
    last = parents.shape[0] - 1
    layer = 0
    while layer < last and count > 0:
        here = (layer % 2) * width
        there = width - here
        forget(table)
        made = 0
        for node in range(count):
            for action in range(_ACTIONS):
                _load(world, memory, rows[here + node], 0, columns)
                alive = _step(world, level, action)
                if world.win_timer > 0:
                    worth = item * (world.coins + world.kills) - layer
                    if worth > best:
                        best, best_layer, best_node, best_action = worth, layer, node, action
                        last = min(last, layer + _AFTERWARDS)
                    continue
                mario = world.actors[0]
                if not alive or world.death_timer > 0 or mario.y > np.float32(239):
                    continue
                describe(world, numbers)
                numbers[DESCRIBED] = world.fire
                numbers[DESCRIBED + 1] = world.listed
                numbers[DESCRIBED + 2] = world.change_timer
                if meet(table, numbers):
                    continue
                candidate = candidates[made]
                candidate.parent = node
                candidate.action = action
                candidate.worth = (
                    item * (world.coins + world.kills)
                    + item / 2 * (int(world.large) + int(world.fire))
                    + mario.x / stride(world)
                )
                made += 1
        order = np.argsort(-candidates["worth"][:made])
        count = min(made, width)
        for i in range(count):
            candidate = candidates[order[i]]
            _load(world, memory, rows[here + candidate.parent], 0, columns)
            _step(world, level, candidate.action)
            _save(world, memory, rows[there + i], 0, columns)
            parents[layer + 1, i] = candidate.parent
            actions[layer + 1, i] = candidate.action
        layer += 1
    plan[:] = -1
    if best_layer < 0:
        return 0
    plan[best_layer] = best_action
    node = best_node
    for at in range(best_layer, 0, -1):
        plan[at - 1] = actions[at, node]
        node = parents[at, node]
    return int(best_layer + 1)
