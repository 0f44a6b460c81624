"""Small tasks to try everything on: RL-Glue's skeleton walk, and a grid world with mines."""

from __future__ import annotations

from functools import cache
from typing import Annotated, Final

import numpy as np

from glue.errors import SimulatorError
from glue.options import Option
from glue.roles import Environment
from glue.saves import Saved, pack, pack_generator, unpack, unpack_generator
from glue.taskspec.spaces import Discrete, task_spec
from glue.types import Action, Observation, Step

_LAST_STATE: Final = 20
_FIRST_STATE: Final = 10


class SkeletonEnvironment(Environment):
    """A walk along 21 states, from the middle to either end.

    Action 0 goes down by one, 1 goes up. State 0 ends with reward -1, state 20 with +1; no other step
    is rewarded. Source: RL-Glue 3.0, skeleton example.
    """

    def __init__(self) -> None:
        self._state = _FIRST_STATE

    def env_init(self) -> str:
        states = Discrete(_LAST_STATE + 1)
        return task_spec(states, Discrete(2), rewards=(-1.0, 1.0), extra="skeleton")

    def env_start(self) -> Observation:
        self._state = _FIRST_STATE
        return Observation(ints=(self._state,))

    def env_step(self, action: Action) -> Step:
        move = _one_int(action, high=1)
        self._state = min(max(self._state + (1 if move else -1), 0), _LAST_STATE)
        reward = {0: -1.0, _LAST_STATE: 1.0}.get(self._state, 0.0)
        return Step(reward, Observation(ints=(self._state,)), self._state in (0, _LAST_STATE))

    def env_message(self, message: str) -> str:
        if message == "what is your name?":
            return "my name is skeleton_environment!"
        return "I don't know how to respond to your message"

    def env_save(self) -> bytes:
        return pack(Saved("skeleton", {}, {}, {}))  # nothing outlives an episode

    def env_load(self, data: bytes) -> None:
        if data:  # empty: saved by an earlier version, which stored nothing
            unpack(data, "skeleton", {})


MINES_MAP: Final = (
    "S.......*.........",
    "..*..........*....",
    "....**....*.......",
    ".*........*....*..",
    "......*........*..",
    "..*......*.......G",
)
_DIRECTIONS: Final = ((-1, 0), (1, 0), (0, -1), (0, 1))
_OPEN: Final = tuple(
    [0 <= row + down < len(MINES_MAP) and 0 <= column + right < len(line) for down, right in _DIRECTIONS]
    for row, line in enumerate(MINES_MAP)
    for column in range(len(line))
)
"""For each field, which moves lead into no wall."""
_GOAL_REWARD: Final = 10.0
_MINE_REWARD: Final = -100.0
_STEP_REWARD: Final = -1.0


class MinesEnvironment(Environment):
    """A grid of 6 by 18 fields: reach the goal, step on no mine.

    The observation is the field, row by row (0..107); actions 0..3 go up, down, left, right, and a step
    into a wall does not move. The goal ends the episode with +10, a mine with -100; any other step costs 1.
    With `masks`, steps into a wall are illegal.
    """

    def __init__(
        self,
        *,
        random_start: Annotated[bool, Option("start on any free field instead of the upper left")] = False,
        seed: Annotated[
            int | None, Option("random seed of the starts; the experiment's if not given", low=0)
        ] = None,
        masks: Annotated[bool, Option("say with each observation which moves lead into no wall")] = False,
    ) -> None:
        self.env_masks: bool = masks
        self._random_start = random_start
        self._own_seed = seed
        self._generator = np.random.default_rng(seed or 0)
        fields = "".join(MINES_MAP)
        self._columns = len(MINES_MAP[0])
        self._free = [field for field, what in enumerate(fields) if what in "S."]
        self._fields = fields
        self._field: int | None = None

    def env_seed(self, seed: int) -> None:
        self._generator = np.random.default_rng(seed if self._own_seed is None else self._own_seed)

    def env_init(self) -> str:
        self._field = None
        fields = Discrete(len(self._fields))
        extra = "mines masks" if self.env_masks else "mines"
        return task_spec(
            fields, Discrete(len(_DIRECTIONS)), rewards=(_MINE_REWARD, _GOAL_REWARD), extra=extra
        )

    def env_start(self) -> Observation:
        start = self._fields.index("S")
        self._field = int(self._generator.choice(self._free)) if self._random_start else start
        return _shown(self._field, self.env_masks)

    def env_step(self, action: Action) -> Step:
        if self._field is None:
            raise SimulatorError("env_step needs env_start first")
        move = _one_int(action, high=3)
        if _OPEN[self._field][move]:
            down, right = _DIRECTIONS[move]
            self._field += down * self._columns + right
        what = self._fields[self._field]
        reward = {"G": _GOAL_REWARD, "*": _MINE_REWARD}.get(what, _STEP_REWARD)
        return Step(reward, _shown(self._field, self.env_masks), what in "G*")

    def env_cleanup(self) -> None:
        self._field = None

    def env_message(self, message: str) -> str:
        if message == "map":
            return "\n".join(MINES_MAP)
        return f"unknown message {message!r:.80}; 'map' shows the map"

    def env_save(self) -> bytes:
        return pack_generator("mines", self._generator)

    def env_load(self, data: bytes) -> None:
        self._generator = unpack_generator(data, "mines")


@cache
def _shown(field: int, masks: bool) -> Observation:
    return Observation(ints=(field,), mask=_OPEN[field] if masks else None)


def _one_int(action: Action, high: int) -> int:
    if action.counts != (1, 0, 0):
        raise SimulatorError(f"an action is one int from 0 to {high}, not {action!r}")
    value = int(action.ints[0])
    if not 0 <= value <= high:
        raise SimulatorError(f"an action is one int from 0 to {high}, not {value}")
    return value
