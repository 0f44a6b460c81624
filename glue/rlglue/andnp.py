"""Players of rlglue-andnp: methods `start`, `step` and `end`, and actions that are ints.

Until March 2025 it was called RlGlue. Its environments returned reward, observation and terminal, some with a
fourth value, and its agents took no `extra`; most public code is like that, and is read as well.

Source: rlglue-andnp 2.0.1 (github.com/andnp/rl-glue).
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from operator import index
from typing import Any, ClassVar

import numpy as np

from glue.errors import LocalProtocolError
from glue.rlglue.borrowed import Adapter, EnvironmentAdapter
from glue.roles import Agent, Environment
from glue.types import Action, Observation, Step, arrays_of


class AndnpAgent(Adapter, Agent):
    """An agent of rlglue-andnp. A new one is made for each task.

    It receives an observation of one int as an int, one of ints or doubles as an array, one of chars as an
    array of bytes, and one of several kinds as a dictionary of `ints`, `doubles` and `chars`. `extra` is
    empty, as it is not sent.
    """

    seeded_by: ClassVar[str] = "agent_seed"

    def agent_init(self, task_spec: str) -> None:
        """Make an agent."""
        self._step = _extended(self._new().step, 3)

    def agent_start(self, observation: Observation) -> Action:
        """Begin an episode; return the first action."""
        return _action(self._made.start(_value(observation)))

    def agent_step(self, reward: float, observation: Observation) -> Action:
        """Learn from a reward, and return the next action."""
        return _action(self._step(reward, _value(observation), {}))

    def agent_end(self, reward: float) -> None:
        """Learn from the last reward of an episode."""
        _extended(self._made.end, 2)(reward, {})


class AndnpEnvironment(EnvironmentAdapter, Environment):
    """An environment of rlglue-andnp. A new one is made for each task."""

    def env_init(self) -> str:
        """Make an environment; return the task spec."""
        self._new()
        return self._task_spec

    def env_start(self) -> Observation:
        """Return the first observation of an episode."""
        return _observation(self._made.start())

    def env_step(self, action: Action) -> Step:
        """Carry out an action."""
        if action.counts != (1, 0, 0):
            raise LocalProtocolError(f"an action of rlglue-andnp is one int, not {action!r:.80}")
        truncated = False
        match self._made.step(int(action.ints[0])):
            case (observation, reward, terminal, truncated, _):
                pass
            case (reward, observation, terminal) | (reward, observation, terminal, _):
                pass
            case other:
                raise LocalProtocolError(
                    "a step of rlglue-andnp returns observation, reward, terminal, truncated and extra, or, "
                    f"as in RlGlue, reward, observation and terminal, not {other!r:.80}"
                )
        ended = bool(terminal or truncated)
        return Step(float(reward), _observation(observation), ended, bool(truncated and not terminal))


def _extended(method: Callable[..., Any], count: int) -> Callable[..., Any]:
    """Return a method of `count` arguments that omits the last, `extra`, if `method` does not take it."""
    try:
        inspect.signature(method).bind(*range(count))
    except TypeError:
        return lambda *arguments: method(*arguments[:-1])
    return method


def _action(value: Any) -> Action:
    try:
        return Action([index(value)])
    except TypeError:
        raise LocalProtocolError(f"an action of rlglue-andnp is an int, not {value!r:.80}") from None


def _observation(value: Any) -> Observation:
    """Return `value` as an observation: bytes as chars, other whole numbers as ints, others as doubles."""
    try:
        numbers = np.asarray(value)
    except ValueError:  # of rows with different lengths
        numbers = np.asarray(None)
    flat = numbers.reshape(-1)
    if flat.dtype == np.uint8:
        return Observation(chars=flat.tobytes())
    if flat.dtype.kind in "iub":
        return Observation(flat.astype(np.int64))
    if flat.dtype.kind == "f":
        return Observation(doubles=flat.astype(np.float64))
    raise LocalProtocolError(
        f"an observation of rlglue-andnp must be a number or an array of numbers here, not {value!r:.80}"
    )


def _value(observation: Observation) -> Any:
    """Return an observation in the form that agents of rlglue-andnp take."""
    if observation.counts == (1, 0, 0):
        return int(observation.ints[0])
    found = {name: values for name, values in arrays_of(observation).items() if len(values)}
    return next(iter(found.values())) if len(found) == 1 else found
