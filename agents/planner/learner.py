"""The agent `planner-learns`: the planner in a game whose physical constants and rewards it does not know.

It begins with those of instance 0 and identifies others from its own mispredictions. Until they are known,
it runs to the right for a step, returns to its starting point, and jumps there. See docs/planner.md.

The physical constants of a game, identified from its observations by the model itself.

A candidate is a value for each of `model.CONSTANTS`. It predicts each of the last steps from the observed
state before it; its errors are those of Mario's position and last motion. The Gauss-Newton method reduces the
errors of the latest steps, once for each possible jump time, and a candidate is accepted if it explains more
of the last steps than the constants assumed before.
"""

from __future__ import annotations

import json
import math
from typing import Annotated, Any, ClassVar, Final

import numpy as np
import numpy.typing as npt

from agents.planner.agent import LARGEST, RUN_RIGHT, CountHorizons, PlannerAgent, Sims, StepSeconds
from agents.planner.search import FRICTION, model
from glue.compiled.jit import entry
from glue.compiled.records import Array
from glue.errors import SaveError
from glue.options import Option
from glue.saves import Arrays, Saved
from glue.types import Action, Observation

_place = model.place
_step = model.step
_rewind = model.rewind
_change = model.change

WINDOW: Final = 40
"""Number of steps for a candidate to explain."""
_FITTED: Final = (1, 2, 3, 6)  # latest steps whose errors are reduced
_LEAD: Final = 10  # earlier steps that supply the hidden state of those
_ITERATIONS: Final = 6
_EXPLAINED: Final = 0.002  # pixels
_EXACT: Final = 1e-6  # pixels; no further iteration
_SENSITIVE: Final = 0.3  # pixels per unit of a constant: the least with which a step reveals its value
_REALS: Final = 5
_TIME: Final = model.CONSTANTS.index("jump_time")
_SPEED_JUMP: Final = model.CONSTANTS.index("speed_jump")
_WALL: Final = model.CONSTANTS.index("speed_slidejump")
_LOW: Final = np.array([0.0, 0.0, -8.0, 0.05, -8.0])
_HIGH: Final = np.array([4.0, 8.0, -0.1, 0.999, -0.1])
_TIMES: Final = range(3, 21)
_APART: Final = np.array([0.01, 0.01, 0.01, 0.001, 0.01])  # differences of two candidates, for derivatives
_DIGITS: Final = (1, 2, 3)  # decimal places that a constant may have
_START: Final = -1  # in place of an action: the beginning of an episode

Reals = npt.NDArray[np.float64]


class Physics:
    """The assumed physical constants, and the last steps, which they have to explain.

    Attributes:
        constants: the assumed values of `model.CONSTANTS`, shape (6,).
        known: whether a step has revealed each of them, shape (6,).
        surprises: number of steps whose prediction of Mario was wrong.
    """

    def __init__(self, constants: Reals) -> None:
        self.constants: Reals = constants.copy()
        self.known: npt.NDArray[np.bool_] = np.zeros(len(constants), np.bool_)
        self.surprises: int = 0
        self._roots = np.zeros((WINDOW, model.WORLD.itemsize), np.uint8)
        self._actions = np.zeros(WINDOW, np.int64)
        self._bodies = np.zeros((WINDOW, model.BODY_SIZE), np.uint8)
        self._world, self._level = model.make()
        self._memory = self._world.view(np.uint8)
        self._end = 0

    @property
    def settled(self) -> bool:
        """Whether all constants except the wall jump's speed are known."""
        return bool(np.delete(self.known, _WALL).all())

    def begin(self, worlds: Array) -> None:
        """Record the belief, shape (1,), before the first observation of an episode."""
        self._end = 0
        self.before(worlds, _START)

    def before(self, worlds: Array, action: int) -> None:
        """Record the belief, shape (1,), before an action."""
        i = self._end % WINDOW
        self._roots[i] = worlds.view(np.uint8)
        self._actions[i] = action

    def after(self, level: Array, body: npt.NDArray[np.uint8]) -> bool:
        """Learn from the observation that followed; return whether the assumed constants have changed.

        Args:
            level: the level as it is believed to be, shape (1,).
            body: the observation as the body of an abstract type, shape (model.BODY_SIZE,).
        """
        self._bodies[self._end % WINDOW] = body
        self._end += 1
        self._level = level
        first = max(0, self._end - WINDOW)
        surprised = bool(np.abs(self._errors(self.constants, self._end - 1)).max() > _EXPLAINED)
        self.surprises += int(surprised)
        changed = False
        if surprised or not self.settled:
            changed = surprised and self._fit(first)
            self._see_what_is_known()
        return changed

    def replay(self, worlds: Array) -> None:
        """Give a belief, shape (1,), the hidden state that follows from the constants and the last steps."""
        self._errors(self.constants, max(0, self._end - WINDOW))
        worlds.view(np.uint8)[:] = self._memory

    def _fit(self, first: int) -> bool:
        """Accept the candidate that explains most of the steps from `first` on; return whether it is new."""
        best, most = self.constants, self._score(self.constants, first)
        for count in _FITTED[:1] if self.settled else _FITTED:
            for time in self._times(count):
                candidate = self.constants.copy()
                candidate[_TIME] = time
                candidate = self._solve(candidate, max(first, self._end - count))
                score = self._score(candidate, first)
                if score > most:
                    best, most = candidate, score
        best = self._rounded(best, first)
        changed = not np.array_equal(best, self.constants)
        self.constants = best
        return changed

    def _times(self, count: int) -> range:
        """Return the jump times to try for the latest `count` steps: only one if they make no difference."""
        own = int(self.constants[_TIME])
        other = self.constants.copy()
        other[_TIME] += 1
        begin = max(0, self._end - count)
        same = np.array_equal(self._errors(self.constants, begin), self._errors(other, begin))
        return range(own, own + 1) if same or self.known[_TIME] else _TIMES

    def _solve(self, constants: Reals, begin: int) -> Reals:
        """Return the constants after the Gauss-Newton method on the errors of the steps from `begin` on."""
        for _ in range(_ITERATIONS):
            errors = self._errors(constants, begin).ravel()
            if np.abs(errors).max() < _EXACT:
                break
            change = np.linalg.lstsq(self._slopes(constants, begin), -errors, rcond=1e-6)[0]
            constants = constants.copy()
            constants[:_REALS] = np.clip(constants[:_REALS] + change, _LOW, _HIGH)
        return constants

    def _slopes(self, constants: Reals, begin: int) -> Reals:
        """Return the derivatives of the errors from `begin` on, shape (errors, 5)."""
        errors = self._errors(constants, begin)
        slopes = np.empty((errors.size, _REALS))
        for i in range(_REALS):
            other = constants.copy()
            other[i] += _APART[i]
            slopes[:, i] = (self._errors(other, begin) - errors).ravel() / _APART[i]
        return slopes

    def _rounded(self, constants: Reals, first: int) -> Reals:
        """Return the constants, rounded to few decimals where that explains the steps at least as well."""
        score = self._score(constants, first)
        for i in range(_REALS):
            for digits in _DIGITS:
                candidate = constants.copy()
                candidate[i] = round(constants[i], digits)
                if abs(candidate[i] - constants[i]) < 10.0 ** -(digits + 1):
                    better = self._score(candidate, first)
                    if better >= score:
                        constants, score = candidate, better
                        break
        return constants

    def _score(self, constants: Reals, first: int) -> tuple[int, float]:
        """Return the number of explained steps, and the negative of their remaining errors."""
        largest = np.abs(self._errors(constants, first)).max(1)
        explained = largest <= _EXPLAINED
        return int(explained.sum()), -float(np.round(largest[explained].sum(), 7))

    def _see_what_is_known(self) -> None:
        """Find out which constants the last step reveals, if the assumed constants explain it."""
        begin = self._end - 1
        if np.abs(self._errors(self.constants, begin)).max() > _EXPLAINED:
            return
        told = np.abs(self._slopes(self.constants, begin)).max(0) >= _SENSITIVE
        if told[_SPEED_JUMP] and not self.known[_TIME]:
            told[_SPEED_JUMP] = self._is_only_time(begin)
            self.known[_TIME] = told[_SPEED_JUMP]
        self.known[:_REALS] |= told

    def _is_only_time(self, begin: int) -> bool:
        """Return whether no other jump time explains the steps from `begin` on, with any speed."""
        for time in _TIMES:
            if time != self.constants[_TIME]:
                candidate = self.constants.copy()
                candidate[_SPEED_JUMP] *= candidate[_TIME] / time
                candidate[_TIME] = time
                candidate = self._solve(candidate, begin)
                if np.abs(self._errors(candidate, begin)).max() <= _EXPLAINED:
                    return False
        return True

    def _errors(self, constants: Reals, begin: int) -> Reals:
        """Return the errors in pixels of the steps from `begin` on: of x, y and the last tick's motion."""
        errors = np.empty((self._end - begin, 4))
        root = max(0, self._end - WINDOW, begin - _LEAD)
        history = (self._roots, self._actions, self._bodies)
        replay(self._world, self._memory, self._level, *history, root, begin, self._end, constants, errors)
        return errors


@entry
def replay(
    worlds: Array,
    memory: npt.NDArray[np.uint8],
    levels: Array,
    roots: npt.NDArray[np.uint8],
    actions: npt.NDArray[np.int64],
    bodies: npt.NDArray[np.uint8],
    root: int,
    begin: int,
    end: int,
    constants: Reals,
    errors: Reals,
) -> None:
    """Predict the steps from `root` up to `end`, each from the observation before it.

    Args:
        worlds, memory: a world to step, shape (1,), and its bytes.
        levels: the level, shape (1,).
        roots, actions, bodies: beliefs before the steps, actions, observations after them; step i at i % N.
        root, begin, end: the steps to predict; errors are written from `begin` on.
        constants: the values of `model.CONSTANTS`.
        errors: receives the errors in pixels, shape (end - begin, 4).
    """
    world = worlds[0]
    memory[:] = roots[root % len(roots)]
    _change(worlds, constants)
    for step in range(root, end):
        i = step % len(roots)
        if actions[i] == _START:
            _rewind(worlds, levels)
        else:
            _step(worlds, levels, actions[i])
        mario = world.actors[0]
        x, y = mario.x, mario.y
        dx, dy = mario.x - mario.old_x, mario.y - mario.old_y
        reals = bodies[i].view(np.float64)[2:]
        if step >= begin:
            errors[step - begin, 0] = x - 16.0 * reals[0]
            errors[step - begin, 1] = y - 16.0 * (16.0 - reals[1])
            errors[step - begin, 2] = dx - reals[2] * 16.0 / 5.0
            errors[step - begin, 3] = dy + reals[3] * 16.0 / 5.0
        _place(worlds, levels, bodies[i])


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
