"""The agents for Infinite Mario share their actions, the options of several, and their base class.

An action is a direction, whether to jump and whether to run, held for one step. There are twelve;
Mohan (2010) calls them keystroke-level operators (KLO).
"""

from __future__ import annotations

import abc
from dataclasses import dataclass
from typing import Annotated, ClassVar, Final

import numpy as np

from glue.errors import ConfigError, TaskSpecError
from glue.options import Option
from glue.roles import Agent
from glue.taskspec import MARIO, legal_values, parse_task_spec
from glue.types import Action, BoolArray, Observation

LEFT: Final = -1
STAY: Final = 0
RIGHT: Final = 1

NUM_ACTIONS: Final = 12
ACTIONS: Final = tuple(
    Action(ints=(direction, jump, run))
    for direction in (LEFT, STAY, RIGHT)
    for jump in (0, 1)
    for run in (0, 1)
)
"""The ints of each action by its number: direction -1 to 1, jump 0 or 1, run 0 or 1."""


def action_number(direction: int, jump: bool, run: bool) -> int:
    """Return the number of an action, 0 to 11."""
    return 4 * (direction + 1) + 2 * int(jump) + int(run)


def legal_actions(observation: Observation) -> BoolArray:
    """Return which actions are legal by their numbers, shape (12,): all without a mask.

    Raises:
        RemoteProtocolError: the mask is not one of Mario's actions.
    """
    direction, jump, run = legal_values(observation, (3, 2, 2))
    return np.logical_and.outer(np.logical_and.outer(direction, jump), run).reshape(NUM_ACTIONS)


Seed = Annotated[int | None, Option("random seed; the experiment's if not given", low=0)]


@dataclass(frozen=True, kw_only=True)
class SarsaOptions:
    """The hyper-parameters of SARSA, with the values of Mohan (2010) as defaults."""

    step_size: Annotated[float, Option("step size of SARSA (Mohan 2010: 0.3)", low=0, high=1)] = 0.3
    discount: Annotated[float, Option("discount of SARSA (Mohan 2010: 0.9)", low=0, high=1)] = 0.9
    epsilon: Annotated[float, Option("initial chance to explore (Mohan 2010: 0.1)", low=0, high=1)] = 0.1
    reduction: Annotated[
        float, Option("factor of epsilon per decision cycle (Mohan 2010: 0.9999)", low=0, high=1)
    ] = 0.9999
    seed: Seed = None


class SeededAgent(Agent):
    """An agent with a seed of its own, or the experiment's.

    Args:
        seed: a seed to use instead of the experiment's; None to use the experiment's.
    """

    name: ClassVar[str]

    def __init__(self, seed: int | None) -> None:
        self._own_seed = seed
        self._seed = seed or 0

    def agent_seed(self, seed: int) -> None:
        """Seed every random choice after the next init, unless the option `seed` was given."""
        if self._own_seed is None:
            self._seed = seed

    def _check_task(self, version: str, task_spec: str) -> None:
        """Check the version of a task spec.

        Raises:
            ConfigError: the task is not Infinite Mario.
        """
        if version != MARIO:
            raise ConfigError(
                f"agent {self.name} plays Infinite Mario only, whose task spec begins VERSION {MARIO}; "
                f"it received {task_spec!r:.80}: use it with the environment mario"
            )


class MarioAgent(SeededAgent):
    """An agent for Infinite Mario."""

    @abc.abstractmethod
    def _reset(self) -> None:
        """Forget everything, and seed the random choices with `_seed`."""

    def agent_init(self, task_spec: str) -> None:
        """Forget everything.

        Raises:
            ConfigError: the task is not Infinite Mario.
        """
        try:
            version = parse_task_spec(task_spec).version
        except TaskSpecError:
            version = ""
        self._check_task(version, task_spec)
        self._reset()
