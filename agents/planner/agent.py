"""The agent `planner`: it steps a belief of the game with its own actions, and plans each of them with A*.

It sees only observations, and knows the rules. See docs/planner.md.
"""

from __future__ import annotations

import json
import time
from typing import Annotated, Any, ClassVar, Final

import numpy as np
import numpy.typing as npt

from agents.mario.agent import MarioAgent
from agents.mario.observation import CHARS
from agents.planner.route import Route
from agents.planner.search import SETTINGS, make_room, model, search
from glue.compiled.jit import announce_compilation
from glue.compiled.records import Array
from glue.console import did_you_mean
from glue.errors import ConfigError, SaveError
from glue.options import Option
from glue.saves import Arrays, Saved, pack, unpack
from glue.types import Action, Observation

_LONGEST_PLAN: Final = 64
_WINDOW: Final = 72  # columns that may change during a search
_MAX_SIMS: Final = 200_000
_AHEAD: Final = 16  # columns to look ahead, at most
_PATIENCE: Final = 15  # steps without progress, after which it searches harder
_MORE: Final = 6  # factor of the budget then
_MOST: Final = 30  # factor of the budget after three times as many steps
_MOST_HARD: Final = 50_000  # model steps at most then, unless the option says more
_SECONDS_PER_SIM: Final = 2e-6  # at first
_HORIZONS: Final = (1, 3, 5, 10)  # steps to look ahead
_ACTIONS: Final = [Action(ints=buttons) for buttons in model.ACTIONS.tolist()]
RUN_RIGHT: Final = 9
LARGEST: Final = 100  # absolute value of a constant
_NO_LIMIT: Final = 10**9  # steps; the limit of an episode is not known


Sims = Annotated[int, Option("model steps for each action", low=12, high=_MAX_SIMS)]
StepSeconds = Annotated[
    float | None, Option("time for each action, instead of sims", low=0.0001, high=60, unit="s")
]
CountHorizons = Annotated[bool, Option("count the exact predictions 1, 3, 5 and 10 steps ahead")]


class PlannerAgent(MarioAgent):
    """Plans each action with the rules of the game.

    Args:
        sims: model steps for each action.
        step_seconds: seconds for each action, in place of `sims`; actions then depend on the machine.
        bonus: steps that a coin or a kill is worth; 0 to make only for the goal.
        constants: physical constants of the game that differ from instance 0's, as NAME=VALUE, separated by
            spaces; see `model.CONSTANTS`.
        study: model steps for planning a whole level that it has seen to the end, before each episode on it.
        horizons: also count how many predictions 1, 3, 5 and 10 steps ahead are exact.

    Raises:
        ConfigError: a constant is unknown or is not a number.
    """

    name: ClassVar[str] = "planner"

    def __init__(
        self,
        *,
        sims: Sims = 300,
        step_seconds: StepSeconds = None,
        bonus: Annotated[
            float, Option("what a coin or a kill is worth", low=0, high=1000, unit="steps")
        ] = 0.0,
        constants: Annotated[
            str, Option("physical constants that differ from instance 0's, as NAME=VALUE NAME=VALUE")
        ] = "",
        study: Annotated[
            int, Option("model steps to plan a known level with before an episode", low=0, high=20_000_000)
        ] = 0,
        horizons: CountHorizons = False,
    ) -> None:
        super().__init__(None)
        self._sims = sims
        self._step_seconds = step_seconds
        self._constants = _parse_constants(constants)
        self._scratch, _ = model.make()
        self._memory = self._scratch.view(np.uint8)
        self._seen = np.zeros(1, np.int64)
        self._horizons = Horizons() if horizons else None
        self._body = np.zeros(model.BODY_SIZE, np.uint8)
        self._plan = np.full(_LONGEST_PLAN, -1, np.int64)
        self._settings: Any = np.zeros(1, SETTINGS)
        how = self._settings[0]
        how["weight"], how["coin"], how["kill"], how["size_cost"] = 1.5, bonus, bonus, 6.0
        how["anytime"], how["columns"] = bonus > 0, _WINDOW
        self._room = make_room(0, _WINDOW)
        self._route = Route(study)
        self._warm_up()

    def _warm_up(self) -> None:
        """Compile all functions or load them from disk, so that no step of an episode has to wait."""
        nothing = Observation([0] * 3, [0.0] * 4, bytes(CHARS))
        with announce_compilation(f"the agent {self.name}"):
            self._reset()
            self.agent_start(nothing)
            self.agent_step(0.0, nothing)
        self._reset()

    def _reset(self) -> None:
        """Forget every level."""
        self._worlds, self._levels = model.make(max_trial_steps=_NO_LIMIT)
        self._before = self._worlds.view(np.uint8).copy()  # the world before the last action
        self._seen[0] = 0
        self._assume(self._constants)
        self._route.forget()
        self._steps = self._predicted = self._used = 0
        if self._horizons:
            self._horizons = Horizons()
        self._per_sim = _SECONDS_PER_SIM
        self._ahead = _AHEAD
        self._farthest, self._idle = 0.0, 0

    def _assume(self, constants: npt.NDArray[np.float64]) -> None:
        """Predict and plan with these values of `model.CONSTANTS` from now on."""
        model.change(self._worlds, constants)

    def agent_start(self, observation: Observation) -> Action:
        self._read(observation)
        self._begin()
        return self._act()

    def _begin(self) -> None:
        """Begin an episode with the observation just read."""
        belief = self._worlds, self._levels, self._seen, self._body
        if model.start(*belief):  # not the remembered level
            self._seen[0] = 0
            self._route.forget()
            model.start(*belief)
        self._route.begin(self._worlds, self._levels, int(self._seen[0]))
        if self._horizons:
            self._horizons.start()
        self._plan[:] = -1
        self._farthest, self._idle = 0.0, 0

    def agent_step(self, reward: float, observation: Observation) -> Action:
        self._observe(observation)
        return self._act(reward)

    def _observe(self, observation: Observation) -> bool:
        """Correct the belief by an observation; return whether it was predicted, apart from new columns."""
        self._read(observation)
        self._steps += 1
        if self._horizons:
            self._horizons.compare(self._levels, self._body)
        if not model.finds(self._worlds, self._body):
            self._reconsider()
        is_exact = bool(model.correct(self._worlds, self._levels, self._seen, self._body))
        self._predicted += is_exact
        return is_exact

    def _reconsider(self) -> None:
        """Assume a last action that explains Mario's position: the chosen one was not carried out."""
        for action in range(len(_ACTIONS)):
            self._memory[:] = self._before
            model.step(self._scratch, self._levels, action)
            if model.finds(self._scratch, self._body):
                self._worlds.view(np.uint8)[:] = self._memory
                return

    def agent_save(self) -> bytes:
        """Return the known part of the level as bytes."""
        level, end = self._levels[0], int(self._seen[0])
        arrays = {name: level[name][:end].ravel().view(np.int8) for name in ("tiles", "spawns")}
        numbers = {"end": end, "exit": int(level["exit_x"])}
        return pack(Saved(self.name, {}, numbers, {**arrays, **self._route.saved(), **self._learned()}))

    def _learned(self) -> Arrays:
        """Return the arrays to be saved besides those of the level."""
        return {}

    def _relearn(self, saved: Saved) -> None:
        """Continue with the arrays that `_learned` returned.

        Raises:
            SaveError: `saved` is damaged.
        """

    def agent_load(self, data: bytes) -> None:
        """Continue from a state that `agent_save` returned.

        Raises:
            SaveError: `data` is damaged, or of another agent.
        """
        saved = unpack(data, self.name, {})
        end, goal = saved.number("end", model.COLUMNS), saved.number("exit", 2**20)
        tiles = saved.array("tiles", np.int8)
        spawns = saved.array("spawns", np.int8, low=0, high=15)
        rows = self._levels["tiles"].shape[2]
        if len(tiles) != end * rows or len(spawns) != end * rows:
            raise SaveError(f"saved {self.name}: {end} columns have {end * rows} tiles and spawn points")
        self._reset()
        level = self._levels[0]
        self._seen[0], level["exit_x"] = end, goal
        level["tiles"][:end] = tiles.view(np.uint8).reshape(-1, rows)
        level["spawns"][:] = 0
        level["spawns"][:end] = spawns.view(np.uint8).reshape(-1, rows)
        self._route.restore(saved)
        self._relearn(saved)

    def agent_message(self, message: str) -> str:
        """Answer one of these messages.

        predictions  JSON: steps, steps without any correction, model steps, and horizons
        sims         model steps per step
        marks        JSON: positions of Mario's middle after each action of the plan, x and height in tiles
        """
        if message == "marks":
            return json.dumps(self._foresee())
        if message == "sims":
            return f"{self._used / max(self._steps, 1):.6g}"
        if message != "predictions":
            return "I plan with the rules of the game; ask for predictions, sims or marks"
        answer: dict[str, Any] = {"steps": self._steps, "exact": self._predicted, "sims": self._used}
        if self._horizons:
            answer["horizons"] = self._horizons.shares()
        return json.dumps(answer)

    def _foresee(self) -> list[tuple[float, float]]:
        """Return the position of Mario's middle after each action of the plan: x and height, in tiles."""
        self._memory[:] = self._worlds.view(np.uint8)
        mario = self._scratch[0]["actors"][0]
        places = []
        for action in [*self._plan.tolist(), -1]:
            places.append((round(float(mario["x"]) / 16, 3), round(16.5 - float(mario["y"]) / 16, 3)))
            if action < 0 or not model.step(self._scratch, self._levels, action):
                break
        return places

    def _read(self, observation: Observation) -> None:
        body: npt.NDArray[np.uint8] = np.frombuffer(observation.body, np.uint8)
        self._body[: len(body)] = body

    def agent_end(self, reward: float) -> None:
        """Keep the episode as a route if it is the best on its level."""
        self._route.finish(bool(self._worlds[0]["win_timer"] > 0))

    def _act(self, reward: float = 0.0) -> Action:
        """Carry out the next action in the belief, and return it; `reward` is the last action's."""
        x = float(self._worlds[0]["actors"][0]["x"])
        self._idle = 0 if x > self._farthest + 16 else self._idle + 1
        self._farthest = max(self._farthest, x) if self._idle == 0 else self._farthest
        action = self._route.action(self._worlds, self._levels)
        if action < 0:
            length = self._search(self._idle > _PATIENCE)
            if not self._settings["safe"][0]:
                length = self._search(True)
            action = self._chosen(int(self._plan[0]) if length else RUN_RIGHT)
        self._route.note(action, reward)
        self._plan[:-1] = self._plan[1:]
        if self._horizons:
            self._horizons.step(self._worlds, self._levels, action)
        self._before[:] = self._worlds.view(np.uint8)
        model.step(self._worlds, self._levels, action)
        return _ACTIONS[action]

    def _chosen(self, action: int) -> int:
        """Return the action to carry out when `action` is planned."""
        return action

    def _search(self, hard: bool) -> int:
        """Plan; with `hard`, try all actions with a larger budget. Return the length of the plan."""
        how = self._settings[0]
        how["sims"] = self._budget(hard)
        how["hard"] = hard
        column = int(self._worlds[0]["actors"][0]["x"]) // 16
        how["end"] = min(int(self._seen[0]), column + self._ahead)
        if (nodes := int(how["sims"]) + _LONGEST_PLAN) > len(self._room.nodes):
            self._room = make_room(nodes, _WINDOW)
        world = (self._worlds, self._levels, self._scratch, self._memory)
        began = time.perf_counter()
        length = int(search(*world, *self._room, self._settings, self._plan))
        used = int(how["used"])
        self._used += used
        if used:
            self._per_sim += 0.1 * ((time.perf_counter() - began) / used - self._per_sim)
        return length

    def _budget(self, hard: bool) -> int:
        """Return the model steps of a search. Two searches for an action share its seconds."""
        if self._step_seconds is not None:
            sims = self._step_seconds / 2 / self._per_sim
        else:
            more = _MORE if self._idle < 3 * _PATIENCE else _MOST
            sims = min(self._sims * more, max(self._sims, _MOST_HARD)) if hard else self._sims
        return min(max(int(sims), 12), _MAX_SIMS)


def _parse_constants(text: str) -> npt.NDArray[np.float64]:
    """Parse assignments to `model.CONSTANTS`; return the values of all.

    Raises:
        ConfigError: a constant is unknown or is not a number.
    """
    given: dict[str, float] = {}
    for assignment in text.split():
        name, _, value = assignment.partition("=")
        if name not in model.CONSTANTS:
            raise ConfigError(
                f"constants: {name!r:.40} is not a constant of the game{did_you_mean(name, model.CONSTANTS)}"
            )
        try:
            given[name] = float(value)
            if not abs(given[name]) <= LARGEST:
                raise ValueError
        except ValueError:
            raise ConfigError(
                f"constants: {name} takes a number from -{LARGEST} to {LARGEST}, not {value!r:.40}"
            ) from None
    values: npt.NDArray[np.float64] = model.constants(**given)
    return values


class Horizons:
    """The beliefs of the last steps, each stepped with the actions since, without any correction."""

    def __init__(self) -> None:
        self._worlds = [model.make()[0] for _ in range(_HORIZONS[-1])]
        self._compared = dict.fromkeys(_HORIZONS, 0)
        self._exact = dict.fromkeys(_HORIZONS, 0)
        self._steps = 0

    def start(self) -> None:
        """Begin an episode: nothing has been predicted."""
        self._steps = 0

    def step(self, worlds: Array, levels: Array, action: int) -> None:
        """Predict from the belief `worlds`, shape (1,), before an action, and from the beliefs before it."""
        self._worlds[self._steps % _HORIZONS[-1]].view(np.uint8)[:] = worlds.view(np.uint8)
        self._steps += 1
        for world in self._worlds[: self._steps]:
            model.step(world, levels, action)

    def compare(self, levels: Array, body: npt.NDArray[np.uint8]) -> None:
        """Compare an observation with its predictions."""
        for ahead in _HORIZONS:
            if ahead <= self._steps:
                world = self._worlds[(self._steps - ahead) % _HORIZONS[-1]]
                self._compared[ahead] += 1
                self._exact[ahead] += model.predicts(world, levels, body)

    def shares(self) -> dict[str, float]:
        """Return the share of exact predictions by the steps that they look ahead."""
        return {str(n): self._exact[n] / max(self._compared[n], 1) for n in _HORIZONS}
