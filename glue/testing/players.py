"""Contract checks for agents and environments.

They play a few episodes with random partners, through every turn that an experiment may take: messages
at any time, a start after an unfinished episode, an init without a cleanup, two cleanups. Return values
are checked against the types of `glue.roles` and the task spec. Capabilities are checked if offered.
"""

from __future__ import annotations

import contextlib
import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from glue.errors import GlueError, LocalProtocolError, TaskSpecError
from glue.global_seeds import globals_restored, seed_globals
from glue.roles import Agent, AgentLike, Environment, EnvironmentLike, capabilities, completed
from glue.taskspec import RL_GLUE_3, Range, Ranges, Space, parse_task_spec
from glue.types import AbstractType, Action, Observation, Step, step_of

if TYPE_CHECKING:
    from glue.testing.hub import HubRule


class Rule(StrEnum):
    """Rules for agents and environments."""

    METHODS = "every method of the role is there"
    CALLS = "no call raises that an experiment may make"
    TASK_SPEC = "env_init returns a text, and one that begins with VERSION can be read"
    OBSERVATION = "env_start and env_step return an Observation"
    OBSERVATION_SPACE = "an observation is as the task spec says"
    STEP = "env_step returns a tuple of reward, observation, terminal"
    REWARD = "a reward is a finite number"
    REWARD_RANGE = "a reward is as an RL-Glue-3.0 task spec says"
    TERMINAL = "terminal is True or False"
    ACTION = "agent_start and agent_step return an Action"
    ACTION_SPACE = "an action is as the task spec says"
    MESSAGE = "a message is answered with a text"
    SEED = "equal seeds make equal episodes"
    REPEATABLE = "without seed, equal seeds of Python's and NumPy's global generators make equal episodes"
    AFRESH = "seed and init start afresh, whatever came before"
    SAVE = "save returns bytes, and what loads them continues as what saved them"
    DAMAGE = "load refuses damaged data with an exception"


class ContractBroken(GlueError, AssertionError):
    """An agent, environment or hub breaks the rule `rule`."""

    def __init__(self, rule: Rule | HubRule, what: str) -> None:
        super().__init__(f"{rule}: {what}")
        self.rule = rule


def check_environment(
    factory: Callable[[], EnvironmentLike],
    *,
    action: Callable[[np.random.Generator], Action] | None = None,
    episodes: int = 3,
    steps: int = 200,
    seed: int = 0,
) -> None:
    """Check that the environments that `factory` makes keep the rules of `Rule`.

    Args:
        factory: makes a new environment at each call; a class will do.
        action: draws a legal action. Needed if the task spec does not state the actions, or leaves
            bounds open that the environment does not; without it, actions are drawn from the task spec.
        episodes: the number of episodes in each of at most seven rounds.
        steps: the number of steps after which an episode is cut off.
        seed: the seed of the actions, and of an environment that offers the capability `seed`.

    Raises:
        ContractBroken: the message names the rule that is broken, the call, and what it returned.
        LocalProtocolError: `action` is needed, or `factory` is an environment.
    """
    _refuse_player(factory, "environment")
    _check(lambda: _EnvironmentPlayer(factory(), action, episodes, steps), seed)


def check_agent(
    factory: Callable[[], AgentLike],
    task_spec: str,
    *,
    observation: Callable[[np.random.Generator], Observation] | None = None,
    episodes: int = 3,
    steps: int = 200,
    seed: int = 0,
) -> None:
    """Check that the agents that `factory` makes keep the rules of `Rule` in the task of `task_spec`.

    Args:
        factory: makes a new agent at each call; a class will do.
        task_spec: given to agent_init. Rewards are drawn from its range; if that is open, within 100
            of its one end or of zero.
        observation: draws an observation. Needed if the task spec does not state them, or leaves bounds
            open that the agent does not; without it, observations are drawn from the task spec.
        episodes: the number of episodes in each of at most seven rounds; every other one is cut off.
        steps: the maximum number of steps in an episode.
        seed: the seed of observations and rewards, and of an agent that offers the capability `seed`.

    Raises:
        ContractBroken: the message names the rule that is broken, the call, and what it returned.
        LocalProtocolError: `observation` is needed, or `factory` is an agent.
    """
    _refuse_player(factory, "agent")
    _check(lambda: _AgentPlayer(factory(), observation, episodes, steps, task_spec=task_spec), seed)


def _refuse_player(factory: object, role: str) -> None:
    if not callable(factory):
        name = type(factory).__name__
        raise LocalProtocolError(
            f"check_{role} makes several of your {role}s, so it needs the class, or a function that returns "
            f"a new one: check_{role}({name}, ...) instead of an object of that class"
        )


Trace = list[tuple[str, object]]

_MESSAGES: Final = ("", "what is your name?", "größer\n" * 50)


class _Player(ABC):
    """An agent or environment whose every answer is checked, and the partner that it plays with."""

    prefix: str
    role: Any
    returns: type[AbstractType]
    given: type[AbstractType]
    of_kind: Rule
    in_space: Rule

    def __init__(
        self, player: Any, draw: Callable[[np.random.Generator], Any] | None, episodes: int, steps: int
    ) -> None:
        self.player = completed(player, self.role)
        self.draw = draw or self.drawn_from_the_task_spec
        self.episodes = episodes
        self.steps = steps
        self.own = self.partners = Space(stated=False)  # of what the player returns, and of what it is given
        self.seedable = "seed" in capabilities(player)
        self.saveable = "save" in capabilities(player)
        required = sorted(self.role.__abstractmethods__)
        missing = [name for name in required if not callable(getattr(player, name, None))]
        if missing:
            raise ContractBroken(Rule.METHODS, f"{type(player).__name__} has no {', '.join(missing)}")

    @abstractmethod
    def init(self, seed: int) -> Trace:
        """Seed the player, if it can be seeded, and init it; return the trace."""

    @abstractmethod
    def play(self, generator: np.random.Generator) -> Trace:
        """Play the episodes against a partner that draws from `generator`; return the trace."""

    @abstractmethod
    def start(self, generator: np.random.Generator) -> object:
        """Begin an episode."""

    def call(self, method: str, *arguments: object) -> Any:
        """Return the answer of a method of the player, named without its prefix."""
        try:
            return getattr(self.player, self.prefix + method)(*arguments)
        except Exception as error:
            shown = ", ".join(f"{argument!r:.80}" for argument in arguments)
            raise ContractBroken(
                Rule.CALLS, f"{self.prefix}{method}({shown}) raised {type(error).__name__}: {error}"
            ) from error

    def wrong(self, rule: Rule, method: str, answer: object) -> ContractBroken:
        """Return the error for an answer that breaks `rule`."""
        kind = type(answer).__name__
        return ContractBroken(rule, f"{self.prefix}{method} returned {answer!r:.80}, of type {kind}")

    def checked(self, method: str, value: object) -> Any:
        """Return an observation or action of the player, which must be in its space."""
        if type(value) is not self.returns:
            raise self.wrong(self.of_kind, method, value)
        wrong = self.own.check(value)
        if wrong is not None:
            raise ContractBroken(self.in_space, f"{self.prefix}{method} returned {value!r}: {wrong}")
        return value

    def drawn_from_the_task_spec(self, generator: np.random.Generator) -> Any:
        if not self.partners.stated:
            given, role = self.given.__name__.lower(), self.role.__name__.lower()
            raise LocalProtocolError(
                f"the task spec does not state the {given}s: give check_{role} `{given}`"
            )
        return self.given(*self.partners.sample(generator))

    def send_messages(self) -> None:
        for message in _MESSAGES:
            answer = self.call("message", message)
            if not isinstance(answer, str):
                raise self.wrong(Rule.MESSAGE, "message", answer)

    def save(self) -> bytes:
        data = self.call("save")
        if not isinstance(data, bytes):
            raise self.wrong(Rule.SAVE, "save", data)
        return data

    def refuse(self, data: bytes) -> None:
        """Raise ContractBroken unless the player refuses to load `data`."""
        try:
            getattr(self.player, f"{self.prefix}load")(data)
        except Exception:
            return
        raise ContractBroken(Rule.DAMAGE, f"{self.prefix}load({data!r:.80}) raised nothing")


class _EnvironmentPlayer(_Player):
    prefix = "env_"
    role = Environment
    returns, given = Observation, Action
    of_kind, in_space = Rule.OBSERVATION, Rule.OBSERVATION_SPACE

    def init(self, seed: int) -> Trace:
        if self.seedable:
            self.call("seed", seed)
        task_spec = self.call("init")
        if not isinstance(task_spec, str):
            raise self.wrong(Rule.TASK_SPEC, "init", task_spec)
        self.own = self.partners = Space(stated=False)
        self.rewards = Range()
        try:
            spec = parse_task_spec(task_spec)
        except TaskSpecError as error:
            if task_spec.lstrip()[:7].upper() == "VERSION":
                raise ContractBroken(Rule.TASK_SPEC, f"{error}; in {task_spec!r}") from None
        else:
            self.own, self.partners = spec.observations, spec.actions
            # Mario-v1 gives the range of single rewards, which add up within a step.
            self.rewards = spec.rewards if spec.version == RL_GLUE_3 else Range()
        return [("env_init", task_spec)]

    def play(self, generator: np.random.Generator) -> Trace:
        trace: Trace = []
        for episode in range(self.episodes):
            trace.append((f"env_start of episode {episode}", self.start(generator)))
            for step in range(self.steps):
                answer = self.step(self.draw(generator))
                trace.append((f"env_step {step} of episode {episode}", answer))
                if answer.terminal:
                    break
        return trace

    def start(self, generator: np.random.Generator) -> object:
        return self.checked("start", self.call("start"))

    def step(self, action: Action) -> Step:
        answer = self.call("step", action)
        if type(answer) is not Step and (not isinstance(answer, tuple) or len(answer) != 3):
            raise self.wrong(Rule.STEP, "step", answer)
        reward, observation, terminal, *_ = answer
        if not isinstance(reward, (int, float, np.integer, np.floating)) or not math.isfinite(reward):
            raise self.wrong(Rule.REWARD, "step", reward)
        if float(reward) not in self.rewards:
            raise ContractBroken(Rule.REWARD_RANGE, f"env_step returned {reward}, not in {self.rewards}")
        if not isinstance(terminal, (bool, np.bool_)):
            raise self.wrong(Rule.TERMINAL, "step", terminal)
        self.checked("step", observation)
        return step_of(answer)


class _AgentPlayer(_Player):
    prefix = "agent_"
    role = Agent
    returns, given = Action, Observation
    of_kind, in_space = Rule.ACTION, Rule.ACTION_SPACE

    def __init__(self, *arguments: Any, task_spec: str) -> None:
        super().__init__(*arguments)
        self.task_spec = task_spec
        rewards = Range()
        with contextlib.suppress(TaskSpecError):
            spec = parse_task_spec(task_spec)
            self.own, self.partners, rewards = spec.actions, spec.observations, spec.rewards
        self.rewards = Space(doubles=Ranges.of(rewards))

    def init(self, seed: int) -> Trace:
        if self.seedable:
            self.call("seed", seed)
        self.call("init", self.task_spec)
        return []

    def play(self, generator: np.random.Generator) -> Trace:
        trace: Trace = [("agent_start", self.start(generator))]
        self.call("end", self.draw_reward(generator))  # The first step of an episode may be its last.
        for episode in range(self.episodes):
            trace.append((f"agent_start of episode {episode}", self.start(generator)))
            for step in range(int(generator.integers(self.steps, endpoint=True))):
                reward, observation = self.draw_reward(generator), self.draw(generator)
                action = self.checked("step", self.call("step", reward, observation))
                trace.append((f"agent_step {step} of episode {episode}", action))
            if episode % 2 == 0:  # The others are truncated, of which an agent is not notified.
                self.call("end", self.draw_reward(generator))
        return trace

    def start(self, generator: np.random.Generator) -> object:
        return self.checked("start", self.call("start", self.draw(generator)))

    def draw_reward(self, generator: np.random.Generator) -> float:
        return float(self.rewards.sample(generator)[1][0])


@globals_restored()
def _check(make: Callable[[], _Player], seed: int) -> None:
    if not make().seedable:
        seed_globals(seed)
        once = _run(make(), seed)
        seed_globals(seed)
        _compare(Rule.REPEATABLE, once, _run(make(), seed))
    player = make()
    player.send_messages()
    player.call("cleanup")  # RL-Glue lets an experiment clean up, and send messages, before any init.
    first = _run(player, seed)
    in_mid_episode = _run(player, seed)
    player.call("cleanup")
    player.call("cleanup")
    after_cleanup = _run(player, seed)
    if player.seedable:
        _compare(Rule.SEED, first, _run(make(), seed))
        _compare(Rule.AFRESH, first, in_mid_episode)
        _compare(Rule.AFRESH, first, after_cleanup)
    if player.saveable:
        # In mid-episode for the player, which is not notified that the episode is truncated.
        data = player.save()
        loader = make()
        loader.init(seed + 1)
        stateless = loader.save() == data
        loader.call("load", data)
        _compare(Rule.SAVE, player.play(_partner(seed, 2)), loader.play(_partner(seed, 2)))
        for damaged in (data[:-1], data[: len(data) // 2], data[:1], b""):
            # A player that has nothing to save may accept empty data.
            if damaged != data and (damaged or not stateless):
                other = make()
                other.init(seed)
                other.refuse(damaged)


def _run(player: _Player, seed: int) -> Trace:
    """Return the trace of an init and some episodes; leave the player in the middle of one more."""
    trace = player.init(seed)
    player.send_messages()
    trace += player.play(_partner(seed, 0))
    player.start(_partner(seed, 1))
    player.send_messages()
    return trace


def _partner(seed: int, purpose: int) -> np.random.Generator:
    # Not default_rng(seed): the player may well draw from that.
    return np.random.default_rng((seed, purpose))


def _compare(rule: Rule, one: Trace, other: Trace) -> None:
    for (call, answer), (_, other_answer) in zip(one, other, strict=False):
        if answer != other_answer:
            raise ContractBroken(rule, f"{call} returned {answer!r} once and {other_answer!r} again")
