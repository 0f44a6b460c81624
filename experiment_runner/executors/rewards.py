"""Rewards that are checked to be finite, in the environment's own process.

Hub and protocol carry an infinite reward, or one that is not a number, unchanged, as RL-Glue does. In an
experiment, such a reward is nearly always a mistake, which would only show as a mean that is not a number.
"""

from __future__ import annotations

import math
from typing import Any

from glue.errors import GlueError
from glue.roles import Wrapper
from glue.types import Action, Observation


class FiniteRewards(Wrapper):
    """Wraps `environment`; raises GlueError with the step if its reward is infinite or NaN.

    Args:
        environment: an environment.
    """

    def __init__(self, environment: Any) -> None:
        self.__wrapped__ = environment
        self._start = environment.env_start
        self._step = environment.env_step
        self._steps = 0

    def env_start(self) -> Observation:
        self._steps = 0
        observation: Observation = self._start()
        return observation

    def env_step(self, action: Action) -> Any:
        answer = self._step(action)
        self._steps += 1
        try:
            finite = math.isfinite(answer[0])
        except (TypeError, ValueError, OverflowError, LookupError):
            return answer  # the answer does not begin with a number: the caller complains
        if not finite:
            raise GlueError(
                f"the reward of step {self._steps} is {float(answer[0])}, not a finite number "
                "(a run can be told to accept any reward)"
            )
        return answer
