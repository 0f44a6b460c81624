"""SARSA(0) on a plain table, for tasks with one observed int and one int as action. Sutton and Barto, 6.4.

A step reads and changes a handful of numbers, which plain Python does in a tenth of the time that calling
NumPy for each would take.
"""

from __future__ import annotations

import struct
from array import array
from collections.abc import Sequence
from typing import Annotated, Final

import numpy as np
import numpy.typing as npt

from glue.errors import LocalProtocolError, SaveError
from glue.options import Option
from glue.roles import Agent
from glue.saves import GENERATOR_SIZE, Arrays, Saved, generator_array, is_packed, load_generator, pack, unpack
from glue.taskspec import TaskSpec, legal_values, parse_task_spec
from glue.types import PREFIX_SIZE, Action, Observation


def epsilon_greedy(
    generator: np.random.Generator, epsilon: float, values: Sequence[float], observation: Observation
) -> int:
    """Choose an action of one int: any legal one with the chance to explore, otherwise one of the best.

    Args:
        generator: draws whether to explore, then the action if more than one qualifies.
        epsilon: the chance to explore.
        values: of the actions, from 0 on.
        observation: with the mask of the legal actions, if there is one.

    Raises:
        RemoteProtocolError: the mask does not fit the number of actions.
        LocalProtocolError: a value is NaN.
    """
    choices: Sequence[int] = range(len(values))
    if observation.packed_mask:
        (legal,) = legal_values(observation, (len(values),))
        choices = np.flatnonzero(legal).tolist()
        values = [values[choice] for choice in choices]
    if generator.random() < epsilon:
        return choices[int(generator.integers(len(choices)))]
    highest = max(values)
    best = [choice for choice, value in zip(choices, values, strict=True) if value == highest]
    if not best:
        raise LocalProtocolError(
            "what was learned is NaN: rewards were infinite or NaN, or learning diverged"
        )
    return best[generator.integers(len(best))] if len(best) > 1 else best[0]


_MAX_VALUES: Final = 10_000_000
_INT: Final = struct.Struct("<i")

_OLD_HEAD: Final = struct.Struct(f"<4sII{GENERATOR_SIZE}s")  # of saves before `glue.saves`
_OLD_MAGIC: Final = b"TSA1"

_Learned = tuple[np.random.Generator, tuple[int, int], npt.NDArray[np.float64]]


class SarsaAgent(Agent):
    """Tabular SARSA with epsilon-greedy choice among the legal actions, ties broken at random.

    It plays any task whose task spec bounds one int of observation and one int of action. The discount is
    the task spec's.
    """

    agent_masks = True

    def __init__(
        self,
        *,
        step_size: Annotated[float, Option("share of each error that is learned", low=0, high=1)] = 0.1,
        epsilon: Annotated[float, Option("chance of a random action", low=0, high=1)] = 0.1,
        learning: Annotated[bool, Option("change the values; without, only act on them")] = True,
        seed: Annotated[
            int | None, Option("seed of its random numbers; the experiment's if not given", low=0)
        ] = None,
    ) -> None:
        self._step_size = step_size if learning else 0.0
        self._epsilon = epsilon
        self._own_seed = seed
        self._generator = np.random.default_rng(seed or 0)
        self._discount = 1.0
        self._first_state = 0
        self._first_action = 0
        self._num_states = 1
        self._num_actions = 1
        self._values = array("d", (0.0,))  # those of each state's actions, state by state
        self._state = 0
        self._choice = 0
        self._errors = 0.0  # sum of the absolute TD errors of the episode
        self._updates = 0

    def agent_seed(self, seed: int) -> None:
        self._generator = np.random.default_rng(seed if self._own_seed is None else self._own_seed)

    def agent_init(self, task_spec: str) -> None:
        spec = parse_task_spec(task_spec)
        self._first_state, states = _one_int(spec, "observation")
        self._first_action, actions = _one_int(spec, "action")
        if states * actions > _MAX_VALUES:
            raise LocalProtocolError(
                f"a table of {states} states by {actions} actions is too large; {_MAX_VALUES} values fit"
            )
        assert spec.discount is not None
        self._discount = spec.discount
        self._num_states, self._num_actions = states, actions
        self._values = array("d", bytes(8 * states * actions))

    def agent_start(self, observation: Observation) -> Action:
        self._state = self._state_of(observation)
        self._choice = self._choose(self._state, observation)
        self._errors, self._updates = 0.0, 0
        return self._action()

    def agent_step(self, reward: float, observation: Observation) -> Action:
        state = self._state_of(observation)
        choice = self._choose(state, observation)
        self._learn(reward + self._discount * self._values[state * self._num_actions + choice])
        self._state, self._choice = state, choice
        return self._action()

    def agent_end(self, reward: float) -> None:
        self._learn(reward)

    def agent_message(self, message: str) -> str:
        if message == "values":
            return " ".join(f"{value:.6g}" for value in self._values)
        return f"unknown message {message!r:.80}; 'values' shows the table"

    def agent_metrics(self) -> dict[str, float]:
        """Return settings, the size of the table, and the mean absolute TD error of the episode."""
        return {
            "step size": self._step_size,
            "epsilon": self._epsilon,
            "mean TD error": self._errors / max(self._updates, 1),
            "table size": float(len(self._values)),
        }

    def agent_save(self) -> bytes:
        values = np.frombuffer(self._values)
        arrays: Arrays = {"generator": generator_array(self._generator), "values": values}
        shape = {"states": self._num_states, "actions": self._num_actions}
        return pack(Saved("sarsa", {}, shape, arrays))

    def agent_load(self, data: bytes) -> None:
        generator, shape, values = _unpack(data) if is_packed(data) else _unpack_old(data)
        if shape != (self._num_states, self._num_actions) or values.size != len(self._values):
            raise SaveError(
                f"these values are of a task of {shape[0]} states and {shape[1]} actions; "
                f"this one has {self._num_states} and {self._num_actions}"
            )
        self._generator = generator
        self._values = array("d", values.tobytes())

    def _state_of(self, observation: Observation) -> int:
        ints, doubles, _ = observation.counts
        state = -1
        if ints:
            state = _INT.unpack_from(observation.body, PREFIX_SIZE + 8 * doubles)[0] - self._first_state
        if not 0 <= state < self._num_states:
            raise LocalProtocolError(f"{observation!r} is outside what the task spec says")
        return state

    def _choose(self, state: int, observation: Observation) -> int:
        values = self._values[state * self._num_actions : (state + 1) * self._num_actions]
        return epsilon_greedy(self._generator, self._epsilon, values, observation)

    def _learn(self, target: float) -> None:
        at = self._state * self._num_actions + self._choice
        error = target - self._values[at]
        self._values[at] += self._step_size * error
        self._errors += abs(error)
        self._updates += 1

    def _action(self) -> Action:
        return Action(ints=(self._first_action + self._choice,))


def _one_int(spec: TaskSpec, what: str) -> tuple[int, int]:
    """Return the smallest value of the one int of `what`, and the number of its values."""
    space = spec.actions if what == "action" else spec.observations
    if space.counts == (1, 0, 0):
        low, high = space.ints[0].ends
        if np.isfinite(low) and np.isfinite(high):
            return int(low), int(high) - int(low) + 1
    remedy = "; the agent linear learns from numbers" if what == "observation" and space.doubles else ""
    raise LocalProtocolError(
        f"tabular SARSA needs a task whose {what} is one int with bounds; this one has {str(space) or 'none'}"
        f"{remedy}"
    )


def _unpack(data: bytes) -> _Learned:
    saved = unpack(data, "sarsa", {})
    shape = saved.number("states"), saved.number("actions")
    return saved.generator(), shape, saved.array("values", np.float64)


def _unpack_old(data: bytes) -> _Learned:
    """Read a save of a version before `glue.saves`: magic, shape, generator, values."""
    if len(data) < _OLD_HEAD.size or (len(data) - _OLD_HEAD.size) % 8 or not data.startswith(_OLD_MAGIC):
        raise SaveError(f"these {len(data)} bytes are not a save of agent sarsa")
    _, states, actions, generator = _OLD_HEAD.unpack_from(data)
    values = np.frombuffer(data, "<f8", offset=_OLD_HEAD.size)
    if not np.all(np.isfinite(values)):
        raise SaveError("this save of agent sarsa is damaged: its values must be finite")
    return load_generator(generator), (states, actions), values
