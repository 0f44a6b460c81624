"""Linear SARSA(lambda) over tile coding, for tasks with a few observed numbers and one int as action.

Several grids, each shifted by a fraction of a cell, cover the observation; a value is the sum of the weights
of the cells that the observation lies in. Sutton and Barto, 9.5.4 and 12.7; replacing traces.
"""

from __future__ import annotations

import math
from array import array
from dataclasses import dataclass
from typing import Annotated, Final

import numpy as np

from agents.tabular import epsilon_greedy
from glue.errors import LocalProtocolError, SaveError
from glue.options import Option
from glue.roles import Agent
from glue.saves import Arrays, Saved, generator_array, pack, unpack
from glue.taskspec import Space, parse_task_spec
from glue.types import Action, Observation

_WEIGHTS: Final = 2**20
"""Number of weights; if there are more cells, some share a weight."""
_MAX_ACTIONS: Final = 1000
_MAX_NUMBERS: Final = 16
_LEAST_TRACE: Final = 0.01
"""Smaller traces are dropped."""


class LinearAgent(Agent):
    """Linear SARSA over tile coding, for up to 16 observed numbers, as in CartPole, and one int as action.

    A number without bounds is squashed to (0, 1) by its arc tangent. The discount is the task spec's.
    """

    name = "linear"
    agent_masks = True

    @dataclass(frozen=True, kw_only=True)
    class Options:
        """The hyper-parameters."""

        step_size: Annotated[float, Option("share of each error that is learned", low=0, high=1)] = 0.3
        epsilon: Annotated[float, Option("chance of a random action", low=0, high=1)] = 0.05
        trace: Annotated[float, Option("decay of the eligibility traces, lambda", low=0, high=1)] = 0.9
        tiles: Annotated[int, Option("cells per number", low=1, high=100)] = 8
        tilings: Annotated[int, Option("grids", low=1, high=64)] = 8
        learning: Annotated[bool, Option("change the weights; without, only act on them")] = True
        seed: Annotated[
            int | None, Option("seed of its random numbers; the experiment's if not given", low=0)
        ] = None

    def __init__(self, **options: int | float | bool | None) -> None:
        self._options = self.Options(**options)  # type: ignore[arg-type]
        self._generator = np.random.default_rng(self._options.seed or 0)
        self._discount = 1.0
        self._first_action = 0
        self._num_actions = 1
        self._scales: list[tuple[float, float]] = []
        self._weights = array("d")
        self._traces: dict[int, float] = {}
        self._active: list[int] = []
        self._choice = 0

    def agent_seed(self, seed: int) -> None:
        if self._options.seed is None:
            self._generator = np.random.default_rng(seed)

    def agent_init(self, task_spec: str) -> None:
        """Forget everything, and prepare for the task.

        Raises:
            LocalProtocolError: an action is not one bounded int, or an observation not 1 to 16 numbers.
        """
        spec = parse_task_spec(task_spec)
        low, high = spec.actions.ints[0].ends if spec.actions.counts == (1, 0, 0) else (0.0, math.inf)
        ints, doubles, chars = spec.observations.counts
        if not high - low < _MAX_ACTIONS or chars or not 1 <= ints + doubles <= _MAX_NUMBERS:
            raise LocalProtocolError(
                f"agent {self.name} needs a task whose action is one int of at most {_MAX_ACTIONS} values "
                f"and whose observation is 1 to {_MAX_NUMBERS} numbers, not {str(spec)!r:.80}"
            )
        self._discount = 1.0 if spec.discount is None else spec.discount
        self._first_action, self._num_actions = int(low), int(high - low) + 1
        self._scales = _scales(spec.observations)
        self._weights = array("d", bytes(8 * _WEIGHTS))
        self._traces = {}

    def agent_start(self, observation: Observation) -> Action:
        self._traces = {}
        self._active, self._choice, _ = self._choose(observation)
        return self._action()

    def agent_step(self, reward: float, observation: Observation) -> Action:
        active, choice, value = self._choose(observation)
        self._learn(reward + self._discount * value)
        self._active, self._choice = active, choice
        return self._action()

    def agent_end(self, reward: float) -> None:
        self._learn(reward)

    def agent_message(self, message: str) -> str:
        if message == "weights":
            return str(sum(weight != 0 for weight in self._weights))
        return f"unknown message {message!r:.80}; 'weights' counts those that are not zero"

    def agent_save(self) -> bytes:
        weights = np.frombuffer(self._weights)
        used = np.flatnonzero(weights)
        arrays: Arrays = {
            "generator": generator_array(self._generator),
            "used": used.astype(np.int64),
            "weights": weights[used],
        }
        return pack(Saved(self.name, self._shape(), {}, arrays))

    def agent_load(self, data: bytes) -> None:
        """Continue from a state that `agent_save` returned.

        Raises:
            SaveError: `data` is damaged, or of another task or other grids.
        """
        saved = unpack(data, self.name, self._shape())
        used = saved.array("used", np.int64, low=0, high=_WEIGHTS - 1)
        learned = saved.array("weights", np.float64)
        if len(used) != len(learned):
            raise SaveError(f"saved {self.name}: there is not one weight for each place")
        weights = np.zeros(_WEIGHTS)
        weights[used] = learned
        self._generator = saved.generator()
        self._weights = array("d", weights.tobytes())
        self._traces = {}

    def _shape(self) -> dict[str, int]:
        options = self._options
        numbers = {"numbers": len(self._scales), "actions": self._num_actions}
        return {"tiles": options.tiles, "tilings": options.tilings, **numbers}

    def _choose(self, observation: Observation) -> tuple[list[int], int, float]:
        """Return the cells of an observation's grids, an action, and its value."""
        cells = self._cells([*observation.ints.tolist(), *observation.doubles.tolist()])
        weights, actions = self._weights, self._num_actions
        values = [
            math.fsum(weights[(cell + choice) % _WEIGHTS] for cell in cells) for choice in range(actions)
        ]
        choice = epsilon_greedy(self._generator, self._options.epsilon, values, observation)
        return [(cell + choice) % _WEIGHTS for cell in cells], choice, values[choice]

    def _cells(self, numbers: list[float]) -> list[int]:
        if len(numbers) != len(self._scales):
            raise LocalProtocolError(f"{len(numbers)} numbers were observed, {len(self._scales)} expected")
        tiles, tilings = self._options.tiles, self._options.tilings
        places = [
            tiles * ((number - low) * scale if scale else 0.5 + math.atan(number) / math.pi)
            for number, (low, scale) in zip(numbers, self._scales, strict=True)
        ]
        cells = []
        try:
            for tiling in range(tilings):
                cell = tiling
                for i, place in enumerate(places):
                    # The numbers are shifted by 1, 3, 5... parts, as in Sutton and Barto.
                    cell = cell * (tiles + 2) + int(place + tiling * (2 * i + 1) % tilings / tilings)
                cells.append(cell * self._num_actions)
        except (ValueError, OverflowError):  # of `int`
            raise LocalProtocolError(
                f"{numbers} were observed: a number is NaN, or infinite in spite of bounds"
            ) from None
        return cells

    def _learn(self, target: float) -> None:
        options = self._options
        if not options.learning:
            return
        weights, traces = self._weights, self._traces
        error = target - math.fsum(weights[cell] for cell in self._active)
        decay = self._discount * options.trace
        traces = {cell: kept for cell, trace in traces.items() if (kept := trace * decay) > _LEAST_TRACE}
        traces.update(dict.fromkeys(self._active, 1.0))
        change = options.step_size / options.tilings * error
        for cell, trace in traces.items():
            weights[cell] += change * trace
        self._traces = traces

    def _action(self) -> Action:
        return Action(ints=(self._first_action + self._choice,))


def _scales(space: Space) -> list[tuple[float, float]]:
    """Return the minimum of each number and 1 / its range; (0, 0) for a practically unbounded number."""
    found = []
    for ranges in (space.ints, space.doubles):
        for range_ in ranges:
            low, high = range_.ends
            bounded = high - low < 1e6
            found.append((low, 1 / max(high - low, 1e-9)) if bounded else (0.0, 0.0))
    return found
