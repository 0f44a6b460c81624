"""The modules called rlglue and RlGlue that players import, provided where they are not installed.

RL-Glue's Python codec has never been released for Python 3; its players import little from it.

The module `rlglue.types` of RL-Glue's Python codec, for programs that import it where it is not installed.

Names, arguments and attributes are those of RL-Glue Python Extension 2.02.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Mapping
from copy import deepcopy
from importlib import import_module
from types import ModuleType
from typing import Any, Final, Protocol, Self

from glue.errors import ConfigError, TaskSpecError
from glue.taskspec import NEGINF, POSINF, UNSPEC, Bound, Range, Ranges, TaskSpec, parse_task_spec

Bounds = list["float | str"]
"""Minimum and maximum of a number; NEGINF, POSINF and UNSPEC are texts."""

_SPECIAL: Final = ("UNSPEC", "NEGINF", "POSINF")


class TaskSpecParser:
    """A task spec. The methods are those of rlglue/utils/TaskSpecVRLGLUE3.py.

    Args:
        text: the task spec.

    Attributes:
        valid: whether it can be read.
    """

    def __init__(self, text: str) -> None:
        self.ts: str = text
        self.valid: bool = True
        self.last_error: str = ""
        self._spec = TaskSpec.private("unreadable")
        try:
            self._spec = parse_task_spec(text)
        except TaskSpecError as error:
            self.valid = False
            self.last_error = str(error)

    def Validate(self) -> bool:
        """Return whether the task spec can be read."""
        return self.valid

    def getVersion(self) -> str:
        """Return the version."""
        return self._spec.version

    def getProblemType(self) -> str:
        """Return the problem type."""
        return self._spec.problem_type

    def getDiscountFactor(self) -> float:
        """Return the discount factor."""
        return 1.0 if self._spec.discount is None else float(self._spec.discount)

    def getExtra(self) -> str:
        """Return the text after EXTRA."""
        return self._spec.extra

    def getIntObservations(self) -> list[Bounds]:
        """Return the bounds of each int of an observation."""
        return _bounds(self._spec.observations.ints)

    def getDoubleObservations(self) -> list[Bounds]:
        """Return the bounds of each double of an observation."""
        return _bounds(self._spec.observations.doubles)

    def getCharCountObservations(self) -> int:
        """Return the number of chars of an observation."""
        return self._spec.observations.chars

    def getIntActions(self) -> list[Bounds]:
        """Return the bounds of each int of an action."""
        return _bounds(self._spec.actions.ints)

    def getDoubleActions(self) -> list[Bounds]:
        """Return the bounds of each double of an action."""
        return _bounds(self._spec.actions.doubles)

    def getCharCountActions(self) -> int:
        """Return the number of chars of an action."""
        return self._spec.actions.chars

    def getRewardRange(self) -> list[Bounds]:
        """Return the bounds of the reward, in a list of one."""
        return [_pair(self._spec.rewards)]

    def isSpecial(self, bound: object) -> bool:
        """Return whether a bound is not a number."""
        return bound in _SPECIAL


def _bounds(ranges: Ranges) -> list[Bounds]:
    return [_pair(range_) for range_ in ranges]


def _pair(range_: Range) -> Bounds:
    return [_bound(range_.low), _bound(range_.high)]


def _bound(bound: Bound) -> float | str:
    if bound is UNSPEC:
        return "UNSPEC"
    return {NEGINF: "NEGINF", POSINF: "POSINF"}.get(bound, bound)


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


class _BaseAgent(Protocol):
    """The base class of agents of rlglue-andnp."""


class _BaseEnvironment(Protocol):
    """The base class of environments of rlglue-andnp."""


class _RlGlue:
    """The loop of rlglue-andnp, in whose place ours plays."""

    def __init__(self, agent: object, environment: object) -> None:
        names = " --env ".join(f"rlglue:FILE.py:{type(player).__name__}" for player in (agent, environment))
        raise ConfigError(f"run them with glue-experiment --agent {names}")


class _Agent:
    """The base class of agents of the codec."""


class _Environment:
    """The base class of environments of the codec."""


def _refusing(role: str) -> Callable[[object], None]:
    """Return a replacement for the codec's function that connects a player; it raises ConfigError."""

    def load(player: object) -> None:
        raise ConfigError(f"run it with glue-{role} rlglue:FILE.py:{type(player).__name__}")

    return load


_TYPES: Final = (
    *(RL_Abstract_Type, Action, Observation, Observation_action),
    *(Reward_observation_terminal, Reward_observation_action_terminal),
)
_ANDNP: Final = {"BaseAgent": _BaseAgent, "BaseEnvironment": _BaseEnvironment, "RlGlue": _RlGlue}
_MODULES: Final[Mapping[str, Mapping[str, object]]] = {
    "rlglue": _ANDNP,
    "rlglue.types": {kind.__name__: kind for kind in _TYPES},
    "rlglue.agent": {"BaseAgent": _BaseAgent},
    "rlglue.agent.Agent": {"Agent": _Agent},
    "rlglue.agent.AgentLoader": {"loadAgent": _refusing("agent")},
    "rlglue.environment": {"BaseEnvironment": _BaseEnvironment},
    "rlglue.environment.Environment": {"Environment": _Environment},
    "rlglue.environment.EnvironmentLoader": {"loadEnvironment": _refusing("env")},
    "rlglue.utils": {},
    "rlglue.utils.TaskSpecVRLGLUE3": {"TaskSpecParser": TaskSpecParser},
    "RlGlue": _ANDNP,
    "RlGlue.agent": {"BaseAgent": _BaseAgent},
    "RlGlue.environment": {"BaseEnvironment": _BaseEnvironment},
}
"""Contents of each module, a package before its modules."""


def provide() -> None:
    """Make the modules importable: those that are installed and work, and ours in place of the others."""
    for name, contents in _MODULES.items():
        try:
            import_module(name)
        except (ImportError, SyntaxError):  # written for Python 2
            module: Any = ModuleType(name)
            module.__path__ = []
            vars(module).update(contents)
            sys.modules[name] = module
            package, _, attribute = name.rpartition(".")
            if package:
                setattr(sys.modules[package], attribute, module)
