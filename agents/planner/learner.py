"""The agent `planner-learns`: the planner in a game whose physical constants and rewards it does not know.

It begins with those of instance 0 and identifies others from its own mispredictions. Until they are known,
it runs to the right for a step, returns to its starting point, and jumps there. See docs/planner.md.
"""

from __future__ import annotations

import json
import math
from typing import Annotated, Any, ClassVar, Final

import numpy as np
import numpy.typing as npt

from agents.planner.agent import (
    LARGEST,
    RUN_RIGHT,
    CountHorizons,
    PlannerAgent,
    Sims,
    StepSeconds,
)
from agents.planner.physics import Physics
from agents.planner.search import FRICTION, model
from glue.errors import SaveError
from glue.options import Option
from glue.saves import Arrays, Saved
from glue.types import Action, Observation

_PROBING: Final = 25  # steps of an episode, at most
_JUMP: Final = 2  # part of an action's number
_LEFT, _STAY, _RIGHT = 0, 4, 8
_COURT: Final = (32.0, 64.0)  # pixels: a range in which every level has ground, and no ceiling
_SPEEDS: Final = [model.CONSTANTS.index(name) for name in ("speed_walk", "speed_run")]
_GUESS: Final = np.array([-0.01, 1.0, 1.0])
_TRUST: Final = 0.001  # weight of the guess, in observations


class LearningPlannerAgent(PlannerAgent):
    """Plans each action with the rules of the game, whose constants and rewards it learns.

    Args:
        sims: model steps for each action.
        step_seconds: seconds for each action, in place of `sims`; actions then depend on the machine.
        bonus: steps that a reward of 1 for a coin or a kill is worth; 0 to make only for the goal.
        horizons: also count how many predictions 1, 3, 5 and 10 steps ahead are exact.
    """

    name: ClassVar[str] = "planner-learns"

    def __init__(
        self,
        *,
        sims: Sims = 300,
        step_seconds: StepSeconds = None,
        bonus: Annotated[
            float, Option("what a reward of 1 for a coin or a kill is worth", low=0, high=1000, unit="steps")
        ] = 0.0,
        horizons: CountHorizons = False,
    ) -> None:
        self._bonus = bonus
        super().__init__(sims=sims, step_seconds=step_seconds, bonus=bonus, horizons=horizons)

    def _reset(self) -> None:
        """Forget every level, the constants and the rewards."""
        super()._reset()
        self._physics = Physics(self._constants)
        self._rewards = Rewards()
        self._probes = 0
        self._counts = np.zeros(2, np.int64)

    @property
    def physics(self) -> Physics:
        """The physical constants, as far as they are known."""
        return self._physics

    def agent_start(self, observation: Observation) -> Action:
        before = self._worlds.copy()
        self._read(observation)
        self._begin()
        self._physics.begin(before)
        self._probes = 0
        self._identify()
        return self._act()

    def agent_step(self, reward: float, observation: Observation) -> Action:
        coins, kills = (self._count() - self._counts).tolist()
        if self._observe(observation):
            self._rewards.note(reward, coins, kills)
        self._identify()
        return self._act()

    def _reconsider(self) -> None:
        """Doubt the last action only once the constants are known; until then, they are the cause."""
        if self._physics.settled:
            super()._reconsider()

    def agent_end(self, reward: float) -> None:
        """Learn the reward for the end of an episode."""
        super().agent_end(reward)
        self._rewards.note_end(reward, bool(self._worlds[0]["win_timer"] > 0))

    def agent_message(self, message: str) -> str:
        """Answer `physics` with JSON: constants, known constants, rewards; other messages as the planner."""
        if message != "physics":
            return super().agent_message(message)
        constants = dict(zip(model.CONSTANTS, self._physics.constants.tolist(), strict=True))
        rewards = dict(zip(("step", "coin", "kill"), self._rewards.values.tolist(), strict=True))
        ends = zip(("goal", "death"), self._rewards.ends.tolist(), strict=True)
        rewards.update((name, value) for name, value in ends if not math.isnan(value))
        known = [name for name, known in zip(constants, self._physics.known, strict=True) if known]
        return json.dumps({"constants": constants, "known": known, "rewards": rewards})

    def _identify(self) -> None:
        """Learn the constants from the observation just read, and correct the belief by them."""
        if self._physics.after(self._levels, self._body):
            self._assume(self._physics.constants)
            self._physics.replay(self._worlds)
            model.correct(self._worlds, self._levels, self._seen, self._body)
        worth = self._bonus * np.maximum(self._rewards.values[1:], 0.0)
        how = self._settings[0]
        how["coin"], how["kill"] = worth
        how["anytime"] = bool(worth.max() > 0)

    def _chosen(self, action: int) -> int:
        if not self._physics.settled and self._probes < _PROBING:
            self._probes += 1
            action = self._probe()
        self._counts = self._count()
        self._physics.before(self._worlds, action)
        return action

    def _probe(self) -> int:
        """Return an action that reveals unknown constants."""
        if not self._physics.known[_SPEEDS].all():
            return RUN_RIGHT | _JUMP
        mario = self._worlds[0]["actors"][0]
        stop = float(mario["x"]) + float(mario["vx"]) / (1 - FRICTION)
        return (_LEFT if stop > _COURT[1] else _RIGHT if stop < _COURT[0] else _STAY) | _JUMP

    def _count(self) -> npt.NDArray[np.int64]:
        """Return the predicted coins and kills of the episode."""
        world = self._worlds[0]
        return np.array([world["coins"], world["kills"]], np.int64)

    def _learned(self) -> Arrays:
        physics, rewards = self._physics, self._rewards
        return {
            "constants": physics.constants,
            "known": physics.known.view(np.int8),
            "squares": rewards.squares.ravel(),
            "products": rewards.products,
            "ends": np.nan_to_num(rewards.ends),
            "ended": (~np.isnan(rewards.ends)).view(np.int8),
        }

    def _relearn(self, saved: Saved) -> None:
        def read(
            name: str, dtype: type[np.generic], size: int, low: float = -1e12, high: float = 1e12
        ) -> Any:
            array = saved.array(name, dtype, low, high)
            if len(array) != size:
                raise SaveError(f"saved {self.name}: {name!r} must have {size} elements, not {len(array)}")
            return array

        physics, rewards = self._physics, self._rewards
        physics.constants = read("constants", np.float64, len(physics.constants), -LARGEST, LARGEST)
        physics.known = read("known", np.int8, len(physics.known), 0, 1).view(np.bool_)
        rewards.squares = read("squares", np.float64, 9).reshape(3, 3)
        rewards.products = read("products", np.float64, 3)
        ended = read("ended", np.int8, 2, 0, 1).view(np.bool_)
        rewards.ends = np.where(ended, read("ends", np.float64, 2), np.nan)
        self._assume(physics.constants)


class Rewards:
    """Least squares over the steps whose events are known.

    Attributes:
        squares, products: sums over these steps, shapes (3, 3) and (3,).
        ends: the last reward of an episode that ended at the goal, and of one that did not, shape (2,); NaN
            before the first.
    """

    def __init__(self) -> None:
        self.squares: npt.NDArray[np.float64] = _TRUST * np.eye(3)
        self.products: npt.NDArray[np.float64] = _TRUST * _GUESS
        self.ends: npt.NDArray[np.float64] = np.full(2, np.nan)

    def note(self, reward: float, coins: int, kills: int) -> None:
        """Learn from a step, not the last of its episode, with its numbers of coins and kills."""
        events = np.array([1.0, coins, kills])
        self.squares += np.outer(events, events)
        self.products += reward * events

    def note_end(self, reward: float, won: bool) -> None:
        """Learn from the last reward of an episode."""
        self.ends[0 if won else 1] = reward

    @property
    def values(self) -> npt.NDArray[np.float64]:
        """Rewards for a step, for a coin and for a kill, shape (3,); 1 for a coin or a kill not seen yet."""
        return np.asarray(np.linalg.solve(self.squares, self.products), np.float64)
