"""The interfaces a user implements, with RL-Glue's own names.

Any class with these methods will do; it need not inherit from anything. What a class can do beyond them is
a *capability*: a class offers it by having its methods (see `CAPABILITIES`).
Source of names and meaning: RL-Glue 3.0.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Final, Protocol, TypeGuard, TypeVar

if TYPE_CHECKING:
    from glue.types import Action, Observation

__all__ = ["CAPABILITIES", "Agent", "Environment", "capabilities", "offers"]

T = TypeVar("T")


class Environment(Protocol):
    """A task. Called are init, then start and step for each episode, then cleanup."""

    def env_init(self) -> str:
        """Prepare, and return the task spec (see `glue.taskspec`; any text is legal)."""
        ...

    def env_start(self) -> Observation:
        """Begin an episode, and return its first observation."""
        ...

    def env_step(self, action: Action) -> tuple[float, Observation, bool]:
        """Execute `action`; return the reward, the next observation, and whether the episode has ended."""
        ...

    def env_cleanup(self) -> None:
        """Release what init acquired. Another init may follow."""
        ...

    def env_message(self, message: str) -> str:
        """Answer a free-form message. May be called at any time."""
        ...


class Agent(Protocol):
    """A learner. Called are init, then start, step and end for each episode, then cleanup."""

    def agent_init(self, task_spec: str) -> None:
        """Prepare for the task that `task_spec` describes, forgetting any earlier one."""
        ...

    def agent_start(self, observation: Observation) -> Action:
        """Begin an episode; return the first action. An unfinished episode before it was truncated."""
        ...

    def agent_step(self, reward: float, observation: Observation) -> Action:
        """Learn from `reward` for the last action, and return the next one."""
        ...

    def agent_end(self, reward: float) -> None:
        """Learn from the last reward of an episode that has ended in a terminal state."""
        ...

    def agent_cleanup(self) -> None:
        """Release what init acquired. Another init may follow."""
        ...

    def agent_message(self, message: str) -> str:
        """Answer a free-form message. May be called at any time."""
        ...


class SeedableEnvironment(Protocol):
    """Capability `seed`: the experiment's seed reaches the environment before every env_init."""

    def env_seed(self, seed: int) -> None:
        """Seed every random choice from now on; 0 <= seed < 2**63."""
        ...


class SeedableAgent(Protocol):
    """Capability `seed`: the experiment's seed reaches the agent before every agent_init."""

    def agent_seed(self, seed: int) -> None:
        """Seed every random choice from now on; 0 <= seed < 2**63."""
        ...


class SaveableEnvironment(Protocol):
    """Capability `save`: what outlives an episode can be saved and restored."""

    def env_save(self) -> bytes:
        """Return everything that later episodes depend on. Called between episodes."""
        ...

    def env_load(self, data: bytes) -> None:
        """Continue from `data`, which `env_save` of the same class returned. Called after env_init.

        Raises:
            GlueError: `data` is damaged or of another class or version.
        """
        ...


class SaveableAgent(Protocol):
    """Capability `save`: what was learned can be saved and restored."""

    def agent_save(self) -> bytes:
        """Return everything that later episodes depend on: values, generator, counters. Not a pickle."""
        ...

    def agent_load(self, data: bytes) -> None:
        """Continue from `data`, which `agent_save` of the same class returned. Called after agent_init.

        Raises:
            GlueError: `data` is damaged or of another class or version.
        """
        ...


class BatchEnvironment(Protocol):
    """Capability `batch`: the environment is many games; each observation carries a batch of them.

    See `glue.batches`. env_step returns the sum of the rewards, and is never terminal.
    """

    def env_batch(self) -> int:
        """Return how many games there are."""
        ...


class BatchAgent(Protocol):
    """Capability `batch`: the agent acts in many games at once; its actions carry one for each game."""

    def agent_batch(self) -> int:
        """Return how many games it can act in at once; 0 for any number."""
        ...


class TruncatingEnvironment(Protocol):
    """Capability `truncate`: the environment may cut an episode off, in a state that is not terminal."""

    def env_truncated(self) -> bool:
        """Return whether the step that was terminal only cut the episode off.

        Called after each terminal step. If so, the agent gets the step's observation by agent_step, so that
        it can learn from its value; agent_end is not called, and the episode is not counted.
        """
        ...


CAPABILITIES: Final[Mapping[str, tuple[type, ...]]] = {
    "batch": (BatchEnvironment, BatchAgent),
    "seed": (SeedableEnvironment, SeedableAgent),
    "save": (SaveableEnvironment, SaveableAgent),
    "truncate": (TruncatingEnvironment,),
}


def offers(player: object, capability: Callable[..., T]) -> TypeGuard[T]:
    """Return whether a player has all methods of a capability's protocol.

    `isinstance` looks at the class, and would not see the methods that a wrapper delegates.
    """
    methods = [name for name in vars(capability) if not name.startswith("_")]
    return all(callable(getattr(player, name, None)) for name in methods)


def capabilities(player: object) -> tuple[str, ...]:
    """Return the names of the capabilities that an agent or environment offers, sorted."""
    return tuple(
        sorted(name for name, kinds in CAPABILITIES.items() if any(offers(player, kind) for kind in kinds))
    )
