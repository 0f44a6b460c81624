"""Base class of the agents for Infinite Mario: name, seed, and the check of the task."""

from __future__ import annotations

import abc
from typing import ClassVar

from glue.errors import ConfigError, TaskSpecError
from glue.roles import Agent
from glue.taskspec import MARIO, parse_task_spec


class MarioAgent(Agent):
    """An agent for Infinite Mario.

    Args:
        seed: a seed to use instead of the experiment's; None to use the experiment's.
    """

    name: ClassVar[str]

    def __init__(self, seed: int | None) -> None:
        self._own_seed = seed
        self._seed = seed or 0

    @abc.abstractmethod
    def _reset(self) -> None:
        """Forget everything, and seed the random choices with `_seed`."""

    def agent_seed(self, seed: int) -> None:
        """Seed every random choice after the next init, unless the option `seed` was given."""
        if self._own_seed is None:
            self._seed = seed

    def agent_init(self, task_spec: str) -> None:
        """Forget everything.

        Raises:
            ConfigError: the task is not Infinite Mario.
        """
        try:
            version = parse_task_spec(task_spec).version
        except TaskSpecError:
            version = ""
        if version != MARIO:
            raise ConfigError(
                f"agent {self.name} plays Infinite Mario only, whose task spec begins VERSION {MARIO}; "
                f"it received {task_spec!r:.80}: use it with the environment mario"
            )
        self._reset()
