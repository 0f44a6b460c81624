"""An environment whose rewards are checked to be numbers.

Hub and protocol carry an infinite reward, or one that is not a number, unchanged, as RL-Glue does. In an
experiment it is nearly always a mistake, which nobody would see but in a mean that is not a number.
"""

from __future__ import annotations

import math
from typing import Any

from glue.errors import GlueError
from glue.types import Action, Observation

__all__ = ["FiniteRewards"]


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
        # What is not a tuple with a number first is for the caller to complain of.
        if type(answer) is tuple and answer and _is_not_finite(answer[0]):
            raise GlueError(
                f"the reward of step {self._steps} is {float(answer[0])}, not a finite number "
                "(if the task means it, say --any-reward)"
            )
        return answer


def _is_not_finite(reward: Any) -> bool:
    try:
        return not math.isfinite(reward)
    except (TypeError, ValueError, OverflowError):
        return False
