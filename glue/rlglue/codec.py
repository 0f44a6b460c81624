"""Players of RL-Glue's Python codec: methods like ours, but with values of `rlglue.types`.

A value of `rlglue.types` has lists: `intArray`, `doubleArray`, and `charArray` of texts of one character.
Source: RL-Glue Python Extension 2.02, rlglue/types.py and rlglue/network/Network.py.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any, ClassVar, TypeVar

from glue.errors import LocalProtocolError
from glue.rlglue.borrowed import Adapter, EnvironmentAdapter
from glue.roles import Agent, Environment
from glue.types import AbstractType, Action, Observation, Step

T = TypeVar("T", bound=AbstractType)


class CodecAgent(Adapter, Agent):
    """An agent of the codec. It is made once, and its own `agent_init` prepares it for each task."""

    seeded_by: ClassVar[str] = "agent_seed"

    def agent_init(self, task_spec: str) -> None:
        """Prepare for a task."""
        self._same().agent_init(task_spec)

    def agent_start(self, observation: Observation) -> Action:
        """Begin an episode; return the first action."""
        return _ours(Action, self._made.agent_start(_theirs("Observation", observation)))

    def agent_step(self, reward: float, observation: Observation) -> Action:
        """Learn from a reward, and return the next action."""
        return _ours(Action, self._made.agent_step(reward, _theirs("Observation", observation)))

    def agent_end(self, reward: float) -> None:
        """Learn from the last reward of an episode."""
        self._made.agent_end(reward)

    def agent_cleanup(self) -> None:
        """Clean up."""
        self._made.agent_cleanup()

    def agent_message(self, message: str) -> str:
        """Return the answer to a message."""
        return str(self._same().agent_message(message) or "")


class CodecEnvironment(EnvironmentAdapter, Environment):
    """An environment of the codec. It is made once, and its own `env_init` prepares it again."""

    def env_init(self) -> str:
        """Return the task spec: that of the environment, if its `env_init` returns one."""
        return str(self._same().env_init() or self._task_spec)

    def env_start(self) -> Observation:
        """Return the first observation of an episode."""
        return _ours(Observation, self._made.env_start())

    def env_step(self, action: Action) -> Step:
        """Carry out an action."""
        result = self._made.env_step(_theirs("Action", action))
        return Step(float(result.r), _ours(Observation, result.o), bool(result.terminal))

    def env_cleanup(self) -> None:
        """Clean up."""
        self._made.env_cleanup()

    def env_message(self, message: str) -> str:
        """Return the answer to a message."""
        return str(self._same().env_message(message) or "")


def _theirs(name: str, value: AbstractType) -> Any:
    """Return a value as one of `rlglue.types`."""
    made = getattr(import_module("rlglue.types"), name)()
    made.intArray = value.ints.tolist()
    made.doubleArray = value.doubles.tolist()
    made.charArray = list(value.chars.decode("latin-1"))
    return made


def _ours(kind: type[T], value: Any) -> T:
    """Return a value of `rlglue.types` as one of ours.

    Raises:
        LocalProtocolError: `value` is not one.
    """
    try:
        chars = b"".join(c if isinstance(c, bytes) else c.encode("latin-1") for c in value.charArray)
        return kind(value.intArray, value.doubleArray, chars)
    except (AttributeError, TypeError, ValueError) as error:
        expected = f"an {kind.__name__} of rlglue.types, with intArray, doubleArray and charArray"
        raise LocalProtocolError(f"expected {expected}; got {value!r:.80} ({error})") from None
