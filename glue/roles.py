"""Agents and environments: the classes that a user writes, with RL-Glue's own names.

A class derives from `Agent` or `Environment` and overrides what it needs; the methods without a default are
abstract. A class that derives from neither works as well, if it has those methods (`AgentLike`,
`EnvironmentLike`). Everything beyond them is a *capability*, which a class offers by having its methods (see
`CAPABILITIES`).
Source of names and meaning: RL-Glue 3.0.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Protocol, TypeGuard, TypeVar

if TYPE_CHECKING:  # NumPy is not needed for a command's help
    from glue.types import Action, Observation, Step

T = TypeVar("T")


class Environment(ABC):
    """A task. The order of calls is init; then start and step... for each episode; then cleanup."""

    @abstractmethod
    def env_init(self) -> str:
        """Prepare, and return the task spec (see `glue.taskspec`; any text is legal)."""

    @abstractmethod
    def env_start(self) -> Observation:
        """Begin an episode, and return its first observation."""

    @abstractmethod
    def env_step(self, action: Action) -> Step | tuple[float, Observation, bool]:
        """Execute `action`, and return its result: a `Step`, or its first three values."""

    def env_cleanup(self) -> None:
        """Release what init acquired. Another init may follow. By default there is nothing to release."""
        return

    def env_message(self, message: str) -> str:
        """Answer a free-form message, which may come at any time. By default the answer is empty."""
        return ""


class Agent(ABC):
    """A learner. The order of calls is init; then start, step... and end for each episode; then cleanup."""

    def agent_init(self, task_spec: str) -> None:
        """Prepare for the task that `task_spec` describes, forgetting any earlier one."""
        return

    @abstractmethod
    def agent_start(self, observation: Observation) -> Action:
        """Begin an episode; return the first action. An unfinished previous episode was truncated."""

    @abstractmethod
    def agent_step(self, reward: float, observation: Observation) -> Action:
        """Learn from `reward` for the last action, and return the next one."""

    def agent_end(self, reward: float) -> None:
        """Learn from the last reward of an episode that has ended in a terminal state."""
        return

    def agent_cleanup(self) -> None:
        """Release what init acquired. Another init may follow. By default there is nothing to release."""
        return

    def agent_message(self, message: str) -> str:
        """Answer a free-form message, which may come at any time. By default the answer is empty."""
        return ""


class EnvironmentLike(Protocol):
    """The methods that an environment must have, whatever its base class."""

    def env_init(self) -> str: ...

    def env_start(self) -> Observation: ...

    def env_step(self, action: Action) -> Step | tuple[float, Observation, bool]: ...


class AgentLike(Protocol):
    """The methods that an agent must have, whatever its base class."""

    def agent_start(self, observation: Observation) -> Action: ...

    def agent_step(self, reward: float, observation: Observation) -> Action: ...


class SeedableEnvironment(Protocol):
    """Capability `seed`: the experiment's seed reaches the environment before every env_init."""

    def env_seed(self, seed: int) -> None:
        """Seed every random choice from now on; 0 <= seed < 2**63."""


class SeedableAgent(Protocol):
    """Capability `seed`: the experiment's seed reaches the agent before every agent_init."""

    def agent_seed(self, seed: int) -> None:
        """Seed every random choice from now on; 0 <= seed < 2**63."""


class SaveableEnvironment(Protocol):
    """Capability `save`: the state that outlives an episode can be saved and restored."""

    def env_save(self) -> bytes:
        """Return everything that later episodes depend on. Called between episodes."""

    def env_load(self, data: bytes) -> None:
        """Continue from `data`, which `env_save` of the same class returned. Called after env_init.

        Raises:
            GlueError: `data` is damaged or of another class or version.
        """


class SaveableAgent(Protocol):
    """Capability `save`: the learned state can be saved and restored."""

    def agent_save(self) -> bytes:
        """Return everything that later episodes depend on: values, generator, counters. Not a pickle."""

    def agent_load(self, data: bytes) -> None:
        """Continue from `data`, which `agent_save` of the same class returned. Called after agent_init.

        Raises:
            GlueError: `data` is damaged or of another class or version.
        """


class MetricAgent(Protocol):
    """Capability `metrics`: the agent reports numbers of its own, such as its step size or mean TD error."""

    def agent_metrics(self) -> Mapping[str, float]:
        """Return the current value of each metric by name, without changing the agent.

        It is called between episodes, and during one when the experiment asks for it. The numbers should
        depend only on what `agent_save` saves and on the episode under way or last finished, so that an
        interrupted run has the metrics of an undisturbed one. A name has 1 to 64 characters, without line
        breaks.
        """


class PacedAgent(Protocol):
    """Capability `pace`: the agent is told how much time it has, where the environment does not wait for it.

    See `glue.pace`.
    """

    def agent_pace(self, deadline: float, latency: float) -> None:
        """Note the time for the answer to the agent_step that follows, of an environment with a rate.

        Args:
            deadline: seconds until the environment's next step.
            latency: seconds that the answer before took, the way there and back included.
        """


class BatchEnvironment(Protocol):
    """Capability `batch`: the environment is many games; each of its observations carries a batch.

    See `glue.batches`. env_step returns the sum of the rewards, and is never terminal.
    """

    def env_batch(self) -> int:
        """Return the number of games."""


class BatchAgent(Protocol):
    """Capability `batch`: the agent acts in many games at once; each of its actions carries one per game."""

    def agent_batch(self) -> int:
        """Return the number of games in which it can act at once; 0 for any number."""


class MaskEnvironment(Protocol):
    """Capability `mask`: observations may say which actions are legal.

    The task spec's EXTRA has the word `masks` (`glue.taskspec.TaskSpec.masks`) if they do, and each int of an
    action has two bounds there. See `glue.types.Observation`.
    """

    env_masks: bool
    """True."""


class MaskAgent(Protocol):
    """Capability `mask`: the agent reads the masks of observations; without it there are none in them."""

    agent_masks: bool
    """True."""


class ExtrasEnvironment(Protocol):
    """Capability `extras`: observations may carry named values that no agent sees; see `glue.extras`."""

    env_extras: bool
    """True."""


CAPABILITIES: Final[Mapping[str, tuple[type, ...]]] = {
    "batch": (BatchEnvironment, BatchAgent),
    "extras": (ExtrasEnvironment,),
    "mask": (MaskEnvironment, MaskAgent),
    "metrics": (MetricAgent,),
    "pace": (PacedAgent,),
    "seed": (SeedableEnvironment, SeedableAgent),
    "save": (SaveableEnvironment, SaveableAgent),
    "truncate": (EnvironmentLike,),
}


def offers(player: object, capability: Callable[..., T]) -> TypeGuard[T]:
    """Return whether a player has all methods of a capability's protocol, and its attributes are True.

    `isinstance` looks at the class, and would not see the methods that a wrapper delegates.
    """
    methods = [name for name in vars(capability) if not name.startswith("_")]
    attributes: Mapping[str, object] = getattr(capability, "__annotations__", {})
    return all(callable(getattr(player, name, None)) for name in methods) and all(
        getattr(player, name, None) is True for name in attributes
    )


def capabilities(player: object) -> tuple[str, ...]:
    """Return the names of the capabilities that an agent or environment offers, sorted."""
    return tuple(
        sorted(name for name, kinds in CAPABILITIES.items() if any(offers(player, kind) for kind in kinds))
    )


class Wrapper:
    """A player around another, `__wrapped__`, which has all the methods that this one has not."""

    __wrapped__: Any

    def __getattr__(self, name: str) -> Any:
        return getattr(self.__wrapped__, name)


class _Completed(Wrapper):
    """A player completed with the methods that its class leaves out."""

    def __init__(self, player: Any, base: type, missing: list[str]) -> None:
        self.__wrapped__ = player
        for name in missing:
            setattr(self, name, partial(getattr(base, name), player))


def completed(player: Any, base: type) -> Any:
    """Return `player` with all optional methods of its role; those it lacks come from the base class.

    Args:
        player: an agent or environment of any class.
        base: `Agent` or `Environment`.
    """
    required: frozenset[str] = base.__abstractmethods__  # type: ignore[attr-defined]
    optional = [name for name in vars(base) if not name.startswith("_") and name not in required]
    missing = [name for name in optional if not callable(getattr(player, name, None))]
    return _Completed(player, base, missing) if missing else player
