"""Carry out RL-Glue's calls on a user's agent or environment.

For each role there is one table of functions by message kind. Each function calls the user's method and
checks the answer, because a wrong answer is best reported where it was made. `glue.engine.local` and
`glue.client` share these tables.

An action or observation must have as many ints, doubles and chars as the task spec says, if it says so. This
is checked on return, by comparing the twelve bytes of the counts; using `_body` instead of `body` keeps the
check below one percent of the fastest step. `glue.testing` checks that each number is in its range.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Container, Mapping
from contextlib import suppress
from typing import Any, Final

from glue.engine.metrics import checked_metrics
from glue.errors import PeerFailed, TaskSpecError
from glue.roles import (
    Agent,
    BatchEnvironment,
    Environment,
    MetricAgent,
    PacedAgent,
    SaveableAgent,
    SaveableEnvironment,
    SeedableAgent,
    SeedableEnvironment,
    capabilities,
    completed,
    offers,
)
from glue.taskspec import Space, mask_sizes, parse_task_spec
from glue.taskspec.masks import mask_fault
from glue.types import (
    BESIDE_AT,
    CUT_OFF,
    NOTHING_BESIDE,
    AbstractType,
    Action,
    Observation,
    beside_sizes,
    step_of,
)
from glue.wire.beside import beside_without
from glue.wire.messages import BESIDE, CALLS, EXTRAS, MASK, Kind, Role

Answer = tuple[tuple[Any, ...], Any]
Handler = Callable[[tuple[Any, ...], Any], Answer]

_DONE: Final[Answer] = ((), None)


def name_of(player: object) -> str:
    """Return the name of a player for messages; for a wrapper, the name of the object within."""
    while (wrapped := getattr(player, "__wrapped__", None)) is not None:
        player = wrapped
    return type(player).__name__


def role_calls(role: Role, player: Any) -> dict[Kind, Handler]:
    """Return the calls that `player` supports, by message kind; see `agent_calls`, `environment_calls`.

    Raises:
        PeerFailed: a method of the role is missing.
    """
    base: Any = Agent if role is Role.AGENT else Environment
    missing = [name for name in sorted(base.__abstractmethods__) if not callable(getattr(player, name, None))]
    if missing:
        raise PeerFailed(f"{name_of(player)} is not an {role}: it has no {', '.join(missing)}")
    if role is Role.AGENT:
        return agent_calls(completed(player, Agent))
    return environment_calls(completed(player, Environment))


def agent_calls(agent: Agent) -> dict[Kind, Handler]:
    """Return a function for each call that `agent` supports."""

    seen = made = b""

    def init(_: tuple[Any, ...], task_spec: Any) -> Answer:
        nonlocal seen, made
        seen, made = _counts(task_spec)
        agent.agent_init(task_spec)
        return _DONE

    def start(_: tuple[Any, ...], observation: Any) -> Answer:
        try:
            action = agent.agent_start(observation)
        except Exception as error:
            _blame_sender(error, observation, seen, Role.ENVIRONMENT)
            raise
        if type(action) is not Action:
            raise _wrong(agent, "agent_start", "an Action", action)
        if made and not action._body.startswith(made):
            raise _miscounted(agent, "agent_start", action, made)
        return (), action

    def step(scalars: tuple[Any, ...], observation: Any) -> Answer:
        try:
            action = agent.agent_step(scalars[0], observation)
        except Exception as error:
            _blame_sender(error, observation, seen, Role.ENVIRONMENT)
            raise
        if type(action) is not Action:
            raise _wrong(agent, "agent_step", "an Action", action)
        if made and not action._body.startswith(made):
            raise _miscounted(agent, "agent_step", action, made)
        return (), action

    def message(_: tuple[Any, ...], text: Any) -> Answer:
        return (), _text(agent, "agent_message", agent.agent_message(text))

    calls: dict[Kind, Handler] = {
        Kind.AGENT_INIT: init,
        Kind.AGENT_START: start,
        Kind.AGENT_STEP: step,
        Kind.AGENT_END: _teller(agent.agent_end),
        Kind.AGENT_CLEANUP: _teller(agent.agent_cleanup),
        Kind.AGENT_MESSAGE: message,
    }
    if offers(agent, SeedableAgent):
        calls[Kind.AGENT_SEED] = _teller(agent.agent_seed)
    if offers(agent, SaveableAgent):
        calls[Kind.AGENT_SAVE] = _saver(agent, "agent_save", agent.agent_save)
        calls[Kind.AGENT_LOAD] = _loader(agent.agent_load)
    if offers(agent, MetricAgent):
        calls[Kind.AGENT_METRICS] = _metrics(agent, agent.agent_metrics)
    if offers(agent, PacedAgent):
        calls[Kind.AGENT_STEP] = _told(agent.agent_pace, step)
    return calls


def environment_calls(environment: Environment) -> dict[Kind, Handler]:
    """Return a function for each call that `environment` supports."""

    shown = received = b""
    beside = _Beside(environment)
    careful = True  # observations may have something beside their numbers

    def init(_: tuple[Any, ...], __: Any) -> Answer:
        nonlocal shown, received, careful
        task_spec = _text(environment, "env_init", environment.env_init())
        shown, received = _counts(task_spec)
        careful = beside.init(task_spec, stated=bool(shown))
        if shown and not careful:
            shown += NOTHING_BESIDE
        return (), task_spec

    def start(_: tuple[Any, ...], __: Any) -> Answer:
        observation = environment.env_start()
        if type(observation) is not Observation:
            raise _wrong(environment, "env_start", "an Observation", observation)
        if shown and not observation._body.startswith(shown):
            beside.check("env_start", observation)
            raise _miscounted(environment, "env_start", observation, shown)
        if careful and not observation._body.startswith(NOTHING_BESIDE, BESIDE_AT):
            beside.check("env_start", observation)
        return (), observation

    def step(_: tuple[Any, ...], action: Any) -> Answer:
        try:
            answer = environment.env_step(action)
        except Exception as error:
            _blame_sender(error, action, received, Role.AGENT)
            raise
        try:
            taken = step_of(answer)
        except (TypeError, ValueError, OverflowError):
            raise _wrong(environment, "env_step", "Step(reward, observation, terminal)", answer) from None
        observation = taken.observation
        if type(observation) is not Observation:
            raise _wrong(environment, "env_step", "a Step with an Observation", answer)
        if shown and not observation._body.startswith(shown):
            beside.check("env_step", observation)
            raise _miscounted(environment, "env_step", observation, shown)
        if careful and not observation._body.startswith(NOTHING_BESIDE, BESIDE_AT):
            beside.check("env_step", observation)
        return (taken.reward, CUT_OFF if taken.truncated else taken.terminal), observation

    def message(_: tuple[Any, ...], text: Any) -> Answer:
        return (), _text(environment, "env_message", environment.env_message(text))

    calls: dict[Kind, Handler] = {
        Kind.ENV_INIT: init,
        Kind.ENV_START: start,
        Kind.ENV_STEP: step,
        Kind.ENV_CLEANUP: _teller(environment.env_cleanup),
        Kind.ENV_MESSAGE: message,
    }
    if offers(environment, SeedableEnvironment):
        calls[Kind.ENV_SEED] = _teller(environment.env_seed)
    if offers(environment, SaveableEnvironment):
        calls[Kind.ENV_SAVE] = _saver(environment, "env_save", environment.env_save)
        calls[Kind.ENV_LOAD] = _loader(environment.env_load)
    return calls


def unsupported(kind: Kind, role: Role, name: str) -> str:
    """Return the error message for a call of a capability that a player does not offer."""
    return f"{role} {name} does not support this: it has no {kind.name.lower()}"


def unfit_for_batch(
    environment: Container[str], agent: Container[str], name: str, paced: bool = False
) -> str:
    """Return why an agent cannot act in an environment, given the capabilities of both; "" if it can.

    `paced` says whether the environment has a pace: the rewards of many games could not be added up.
    """
    if "batch" in environment and paced:
        return "an environment of many games at once (capability `batch`) has no rate and no delay"
    if "batch" in environment and "batch" not in agent:
        return (
            f"agent {name} does not support this: it has no agent_batch, and the environment is many games "
            "at once (capability `batch`)"
        )
    return ""


def skippable(kind: Kind) -> bool:
    """Return whether the call is skipped for a player without the capability of `kind`."""
    return CALLS[kind].capability == "seed"


def _teller(method: Callable[..., None]) -> Handler:
    """Return the handler of a call that has an answer without contents."""

    def tell(scalars: tuple[Any, ...], _: Any) -> Answer:
        method(*scalars)
        return _DONE

    return tell


def _told(method: Callable[[float, float], None], step: Handler) -> Handler:
    def paced_step(scalars: tuple[Any, ...], observation: Any) -> Answer:
        if len(scalars) > 1:
            method(*scalars[1:])
        return step(scalars, observation)

    return paced_step


def _saver(player: object, name: str, method: Callable[[], bytes]) -> Handler:
    def save(_: tuple[Any, ...], __: Any) -> Answer:
        data = method()
        if not isinstance(data, bytes):
            raise _wrong(player, name, "bytes", data)
        return (), data

    return save


def _metrics(player: object, method: Callable[[], Mapping[str, float]]) -> Handler:
    def metrics(_: tuple[Any, ...], __: Any) -> Answer:
        found = method()
        try:
            return (), checked_metrics(found)
        except (AttributeError, TypeError, ValueError):
            raise _wrong(player, "agent_metrics", "numbers by name", found) from None

    return metrics


def _loader(method: Callable[[bytes], None]) -> Handler:
    def load(_: tuple[Any, ...], data: Any) -> Answer:
        method(data)
        return _DONE

    return load


def _text(player: object, method: str, value: object) -> str:
    # RL-Glue sends a null answer as the empty string.
    if value is None:
        return ""
    if not isinstance(value, str):
        raise _wrong(player, method, "a str", value)
    return value


_MAX_REMEMBERED: Final = 1024
_LIGHT: Final = 32
"""Maximum number, and size in bytes, of masks that are remembered as right."""


class _Beside:
    """Checks what an environment's observations carry beside their numbers."""

    def __init__(self, environment: Environment) -> None:
        self._name = name_of(environment)
        self._offered = BESIDE.intersection(capabilities(environment))
        if offers(environment, BatchEnvironment):
            self._offered = frozenset()  # the observations of many games have no place for them
        self._sizes: tuple[int, ...] | None = None
        self._right: set[tuple[bytes, int | None]] = set()  # masks that fit, and their numbers of values
        self._parsed = True

    def init(self, task_spec: str, stated: bool) -> bool:
        """Take the task spec; return whether observations have to be checked if their counts are right."""
        self._sizes = None
        self._right.clear()
        self._parsed = stated
        if MASK in self._offered:
            with suppress(TaskSpecError):
                spec = parse_task_spec(task_spec)
                self._parsed = True
                self._sizes = mask_sizes(spec.actions) if spec.masks else None
        return bool(self._offered) or not stated

    def check(self, method: str, observation: Observation) -> None:
        """Raise PeerFailed if an observation that `method` returned has what it must not have."""
        body = observation._body
        mask, extras = beside_sizes(body)
        packed = body[len(body) - extras - mask : len(body) - extras]
        given = getattr(observation, "_mask_values", None) if packed else None  # packed, it is rounded up
        if (packed, given) in self._right and (not extras or EXTRAS in self._offered):
            return  # the usual case
        unoffered = beside_without(body, self._offered)
        if unoffered:
            why = f"with {unoffered}, and does not offer this capability (no batch can)"
        elif packed and not self._parsed:
            why = ""  # nothing is known of the actions
        elif packed and self._sizes is None:
            why = "with a mask; its task spec lacks the word masks in EXTRA, or bounds of an int of an action"
        else:
            fault = mask_fault(packed, self._sizes or ())
            if given is not None and given < (values := sum(self._sizes or ())):
                fault = f"it is of {given} values, and the ints of an action have {values}"
            why = fault and f"whose mask does not fit the task spec: {fault}"
        if why:
            raise PeerFailed(f"{method} of {self._name} returned an observation {why}")
        if len(self._right) == _MAX_REMEMBERED:
            self._right.clear()
        if len(packed) <= _LIGHT:
            self._right.add((packed, given))


_COUNTS: Final = struct.Struct("<3I")


def _counts(task_spec: str) -> tuple[bytes, bytes]:
    """Return the first bytes of the body of observations and of actions; empty where unspecified."""
    try:
        spec = parse_task_spec(task_spec)
    except TaskSpecError:
        return b"", b""
    return _start_of(spec.observations), _start_of(spec.actions)


def _start_of(space: Space) -> bytes:
    return _COUNTS.pack(*space.counts) if space.stated else b""


def _amounts(counts: tuple[int, int, int]) -> str:
    named = zip(counts, ("int", "double", "char"), strict=True)
    return (
        ", ".join(f"{count} {name}{'' if count == 1 else 's'}" for count, name in named if count) or "nothing"
    )


def _miscounted(player: object, method: str, value: AbstractType, start: bytes) -> PeerFailed:
    expected = _amounts(_COUNTS.unpack_from(start))
    return PeerFailed(
        f"{method} of {name_of(player)} must return {expected}, as the task spec says; "
        f"it returned {_amounts(value.counts)}"
    )


def _blame_sender(error: Exception, given: AbstractType, start: bytes, sender: Role) -> None:
    """Raise PeerFailed if the input on which a player raised `error` does not have the task spec's counts."""
    if not given.body.startswith(start):
        raise PeerFailed(
            f"the {sender} sent {_amounts(given.counts)}, and the task spec says "
            f"{_amounts(_COUNTS.unpack(start))} ({type(error).__name__}: {error})"
        ) from error


def _wrong(player: object, method: str, expected: str, value: object) -> PeerFailed:
    return PeerFailed(
        f"{method} of {name_of(player)} must return {expected}; "
        f"it returned {type(value).__name__} {value!r:.80}"
    )
