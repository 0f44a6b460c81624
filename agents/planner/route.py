"""A route: a plan from the beginning of a known level to its goal, made between episodes."""

from __future__ import annotations

import zlib
from typing import Final

import numpy as np

from agents.planner.search import model
from agents.planner.whole import STEP_COST, plan_whole
from glue.compiled.jit import announce_compilation
from glue.compiled.records import Array
from glue.saves import Arrays, Saved

_NOTHING: Final = -1e18


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
                plan = plan_whole(worlds, levels, end, self._sims)
            if self._promised(plan, worlds, levels) > self.earned:
                self._plan = plan

    def action(self, worlds: Array, levels: Array) -> int:
        """Return the next action of the route; -1 if none leads to the goal from the belief."""
        rest = (
            self._plan[len(self._made) :] or self._plan[-1:]
        )  # the last action wins, but the game may notice the end later
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
                return float(world["coins"] + world["kills"]) - STEP_COST * step
            if not alive:
                break
        return _NOTHING
