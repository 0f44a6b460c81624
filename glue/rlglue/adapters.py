"""Players of two packages called rlglue as players of ours, whose options are their constructor's keywords.

rlglue-andnp has methods `start`, `step` and `end`, and actions that are ints. Until March 2025 it was called
RlGlue. Its environments returned reward, observation and terminal, some with a fourth value, and its agents
took no `extra`; most public code is like that, and is read as well.

Players of RL-Glue's Python codec have methods like ours, but values of `rlglue.types`: lists `intArray`,
`doubleArray`, and `charArray` of texts of one character.

Source: rlglue-andnp 2.0.1 (github.com/andnp/rl-glue); RL-Glue Python Extension 2.02, rlglue/types.py and
rlglue/network/Network.py.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from importlib import import_module
from operator import index
from typing import Annotated, Any, ClassVar, Final, TypeVar

import numpy as np

from glue.errors import ConfigError, LocalProtocolError
from glue.options import Option, keywords, option, with_options
from glue.roles import Agent, Environment
from glue.types import AbstractType, Action, Observation, Step, arrays_of

_SEED: Final = "seed"
_TaskSpec = Annotated[str, Option("the task spec, if the environment has none")]


class Adapter:
    """The base of the adapters.

    Args:
        options: keywords of the constructor of `source`.
    """

    source: ClassVar[type]
    """The class of the other package."""

    seeded_by: ClassVar[str]
    """The method by which an experiment seeds the adapter."""

    needs_seed: ClassVar[bool] = False
    """Whether the constructor has a parameter `seed` without default; if no seed is given, it is 0."""

    own_options: ClassVar[tuple[inspect.Parameter, ...]] = ()
    """Options of the adapter itself."""

    def __init__(self, **options: Any) -> None:
        self._options = options
        if self.needs_seed:
            self._options[_SEED] = 0
        self._made: Any = None

    def _new(self) -> Any:
        self._made = self.source(**self._options)
        return self._made

    def _same(self) -> Any:
        """Return the object made last; make the first one if there is none."""
        return self._new() if self._made is None else self._made

    def _seed(self, seed: int) -> None:
        """Make the next object with this seed."""
        self._options[_SEED] = seed
        self._made = None


class EnvironmentAdapter(Adapter):
    """The base of the adapters of environments, many of which have no task spec.

    Args:
        task_spec: a task spec, for agents that need one.
        options: keywords of the environment's constructor.
    """

    seeded_by: ClassVar[str] = "env_seed"
    own_options: ClassVar[tuple[inspect.Parameter, ...]] = (option("task_spec", "", _TaskSpec),)

    def __init__(self, *, task_spec: str = "", **options: Any) -> None:
        super().__init__(**options)
        self._task_spec = task_spec or "VERSION rlglue"


def adapted(adapter: type[Adapter], source: type) -> type[Adapter]:
    """Return the class of adapters for objects of `source`.

    If the constructor of `source` has a parameter `seed`, the experiment's seed is its value.

    Raises:
        ConfigError: another parameter has no default.
    """
    signature = inspect.signature(source).parameters
    for name, parameter in signature.items():
        several = parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD)
        if parameter.default is parameter.empty and not several and name != _SEED:
            raise ConfigError(
                f"{source.__name__}: constructor parameter {name} has no default: "
                "derive a class whose constructor takes no arguments, and name that one"
            )

    def __init__(self: Adapter, **options: Any) -> None:
        adapter.__init__(self, **options)

    options = keywords(source, f"keyword of {source.__name__}", adapter.own_options, _SEED)
    members: dict[str, Any] = {
        "__doc__": source.__doc__,
        "__init__": with_options(__init__, options),
        "__module__": source.__module__,  # repeatability without a seed is up to its author
        "source": source,
    }
    if _SEED in signature:
        members[adapter.seeded_by] = Adapter._seed
        members["needs_seed"] = signature[_SEED].default is inspect.Parameter.empty
    return type(source.__name__, (adapter,), members)


class AndnpAgent(Adapter, Agent):
    """An agent of rlglue-andnp. A new one is made for each task.

    It receives an observation of one int as an int, one of ints or doubles as an array, one of chars as an
    array of bytes, and one of several kinds as a dictionary of `ints`, `doubles` and `chars`. `extra` is
    empty, as it is not sent.
    """

    seeded_by: ClassVar[str] = "agent_seed"

    def agent_init(self, task_spec: str) -> None:
        """Make an agent."""
        self._step = _extended(self._new().step, 3)

    def agent_start(self, observation: Observation) -> Action:
        """Begin an episode; return the first action."""
        return _action(self._made.start(_value(observation)))

    def agent_step(self, reward: float, observation: Observation) -> Action:
        """Learn from a reward, and return the next action."""
        return _action(self._step(reward, _value(observation), {}))

    def agent_end(self, reward: float) -> None:
        """Learn from the last reward of an episode."""
        _extended(self._made.end, 2)(reward, {})


class AndnpEnvironment(EnvironmentAdapter, Environment):
    """An environment of rlglue-andnp. A new one is made for each task."""

    def env_init(self) -> str:
        """Make an environment; return the task spec."""
        self._new()
        return self._task_spec

    def env_start(self) -> Observation:
        """Return the first observation of an episode."""
        return _observation(self._made.start())

    def env_step(self, action: Action) -> Step:
        """Carry out an action."""
        if action.counts != (1, 0, 0):
            raise LocalProtocolError(f"an action of rlglue-andnp is one int, not {action!r:.80}")
        truncated = False
        match self._made.step(int(action.ints[0])):
            case (observation, reward, terminal, truncated, _):
                pass
            case (reward, observation, terminal) | (reward, observation, terminal, _):
                pass
            case other:
                raise LocalProtocolError(
                    "a step of rlglue-andnp returns observation, reward, terminal, truncated and extra, or, "
                    f"as in RlGlue, reward, observation and terminal, not {other!r:.80}"
                )
        ended = bool(terminal or truncated)
        return Step(float(reward), _observation(observation), ended, bool(truncated and not terminal))


def _extended(method: Callable[..., Any], count: int) -> Callable[..., Any]:
    """Return a method of `count` arguments that omits the last, `extra`, if `method` does not take it."""
    try:
        inspect.signature(method).bind(*range(count))
    except TypeError:
        return lambda *arguments: method(*arguments[:-1])
    return method


def _action(value: Any) -> Action:
    try:
        return Action([index(value)])
    except TypeError:
        raise LocalProtocolError(f"an action of rlglue-andnp is an int, not {value!r:.80}") from None


def _observation(value: Any) -> Observation:
    """Return `value` as an observation: bytes as chars, other whole numbers as ints, others as doubles."""
    try:
        numbers = np.asarray(value)
    except ValueError:  # of rows with different lengths
        numbers = np.asarray(None)
    flat = numbers.reshape(-1)
    if flat.dtype == np.uint8:
        return Observation(chars=flat.tobytes())
    if flat.dtype.kind in "iub":
        return Observation(flat.astype(np.int64))
    if flat.dtype.kind == "f":
        return Observation(doubles=flat.astype(np.float64))
    raise LocalProtocolError(
        f"an observation of rlglue-andnp must be a number or an array of numbers here, not {value!r:.80}"
    )


def _value(observation: Observation) -> Any:
    """Return an observation in the form that agents of rlglue-andnp take."""
    if observation.counts == (1, 0, 0):
        return int(observation.ints[0])
    found = {name: values for name, values in arrays_of(observation).items() if len(values)}
    return next(iter(found.values())) if len(found) == 1 else found


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
