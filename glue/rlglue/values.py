"""The module `rlglue.types` of RL-Glue's Python codec, for programs that import it where it is not installed.

Names, arguments and attributes are those of RL-Glue Python Extension 2.02.
"""

from __future__ import annotations

from copy import deepcopy
from typing import Self

__all__ = [
    "Action",
    "Observation",
    "Observation_action",
    "RL_Abstract_Type",
    "Reward_observation_action_terminal",
    "Reward_observation_terminal",
]


class RL_Abstract_Type:
    """Three lists of numbers: ints, doubles, and chars as texts of one character."""

    def __init__(
        self, numInts: int | None = None, numDoubles: int | None = None, numChars: int | None = None
    ) -> None:
        self.intArray: list[int] = [0] * (numInts or 0)
        self.doubleArray: list[float] = [0.0] * (numDoubles or 0)
        self.charArray: list[str] = [""] * (numChars or 0)

    def sameAs(self, otherAbstractType: RL_Abstract_Type) -> bool:
        """Return whether the lists are equal."""
        return vars(self) == vars(otherAbstractType)

    @classmethod
    def fromAbstractType(cls, theAbstractType: RL_Abstract_Type) -> Self:
        """Return a copy of another value as one of this class."""
        made = cls()
        vars(made).update(deepcopy(vars(theAbstractType)))
        return made


class Action(RL_Abstract_Type):
    """The value of an agent."""


class Observation(RL_Abstract_Type):
    """The value of an environment."""


class Observation_action:
    """An observation `o` and the action `a` taken there."""

    def __init__(self, theObservation: Observation | None = None, theAction: Action | None = None) -> None:
        self.o: Observation = theObservation or Observation()
        self.a: Action = theAction or Action()


class Reward_observation_terminal:
    """The result of a step: reward `r`, observation `o`, and whether the episode has ended."""

    def __init__(
        self,
        reward: float | None = None,
        theObservation: Observation | None = None,
        terminal: bool | None = None,
    ) -> None:
        self.r: float = reward or 0.0
        self.o: Observation = theObservation or Observation()
        self.terminal: bool = terminal or False


class Reward_observation_action_terminal(Reward_observation_terminal):
    """The result of a step, and the next action `a`."""

    def __init__(
        self,
        reward: float | None = None,
        theObservation: Observation | None = None,
        theAction: Action | None = None,
        terminal: bool | None = None,
    ) -> None:
        super().__init__(reward, theObservation, terminal)
        self.a: Action = theAction or Action()
