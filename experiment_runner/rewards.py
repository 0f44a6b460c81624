"""Rewards that are checked to be finite: in the environment or, if that is not ours, in the experiment.

Hub and protocol carry an infinite reward, or one that is not a number, unchanged, as RL-Glue does. In an
experiment it is nearly always a mistake, which nobody would see but in a mean that is not a number.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from glue.core.experiment import Experiment
from glue.errors import GlueError
from glue.protocol.messages import Kind, Value
from glue.types import CUT_OFF, Action, Observation

__all__ = ["FiniteRewards", "WatchedRewards"]


class FiniteRewards:
    """`environment`, but a step whose reward is infinite or NaN raises an error that says which; in all
    else it is the same.

    Args:
        environment: an environment.
    """

    def __init__(self, environment: Any) -> None:
        self.__wrapped__ = environment
        self._start = environment.env_start
        self._step = environment.env_step
        self._steps = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self.__wrapped__, name)

    def env_start(self) -> Observation:
        self._steps = 0
        observation: Observation = self._start()
        return observation

    def env_step(self, action: Action) -> tuple[float, Observation, bool]:
        answer: tuple[float, Observation, bool] = self._step(action)
        self._steps += 1
        try:
            finite = math.isfinite(answer[0])
        except (TypeError, ValueError, OverflowError, LookupError):
            return answer  # it does not begin with a number: the caller complains
        if not finite:
            raise GlueError(_not_finite(self._steps, answer[0]))
        return answer


class WatchedRewards(Experiment):
    """`glue`, but an environment whose reward is infinite or NaN raises an error that names it and the step.

    For an environment that joined from outside. Episodes are run step by step, because RL_episode returns no
    single rewards.

    Args:
        glue: a connected experiment.
        name: returns the name of the environment.
    """

    def __init__(self, glue: Experiment, name: Callable[[], str]) -> None:
        self._glue = glue
        self._name = name
        self._steps = 0

    def _call(self, kind: Kind, scalars: tuple[Value, ...] = (), body: Any = None) -> tuple[Any, Any]:
        answer = self._glue._call(kind, scalars, body)
        if kind in (Kind.RL_START, Kind.RL_ENV_START):
            self._steps = 0
        elif kind in (Kind.RL_STEP, Kind.RL_ENV_STEP):
            self._steps += 1
            reward = answer[0][0]
            if not math.isfinite(reward):
                raise GlueError(f"environment {self._name()}: {_not_finite(self._steps, reward)}")
        return answer

    def rl_episode(self, max_steps: int = 0) -> bool:
        self.rl_start()
        num_steps = 1
        while max_steps == 0 or num_steps < max_steps:
            terminal = self.rl_step().terminal
            if terminal:
                return terminal != CUT_OFF
            num_steps += 1
        return False


def _not_finite(step: int, reward: Any) -> str:
    return (
        f"the reward of step {step} is {float(reward)}, not a finite number "
        "(if the task means it, say --any-reward)"
    )
