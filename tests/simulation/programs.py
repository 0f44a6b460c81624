"""Programs of a simulated run: players whose answers depend on all earlier calls, and an experiment.

A call that is left out, made twice or made to another program changes the digest of a player, and with it
every observation, action and reward that follows."""

from __future__ import annotations

import math
import zlib
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

from glue.engine.engine import role_seed
from glue.engine.experiment import Experiment, Start
from glue.engine.local import local
from glue.extras import Extra
from glue.pace import Pace
from glue.roles import Agent, Environment
from glue.types import Action, Observation, Step
from glue.wire.messages import Role

Pause = Callable[[], None]

WAITING = Pace()


def nothing() -> None:
    """Do nothing."""


class _Busy:
    """A player that digests its calls.

    Args:
        bulk: size of its largest observation or action, in bytes.
        pause: called before each answer.
    """

    _letter: bytes

    def __init__(self, bulk: int, pause: Pause = nothing) -> None:
        self._bulk = bulk
        self._pause = pause
        self._digest = 0

    def _mix(self, data: bytes) -> None:
        self._pause()
        self._digest = zlib.crc32(data, self._digest)

    def _answer(self) -> dict[str, Any]:
        """Return the parts of an observation or action."""
        size = self._digest % self._bulk if self._bulk else 0
        return {"ints": [self._digest & 0x7FFF_FFFF], "chars": self._letter * size}

    def _seed(self, seed: int) -> None:
        self._digest = seed & 0xFFFF_FFFF

    def _save(self) -> bytes:
        return self._digest.to_bytes(4, "little")

    def _load(self, data: bytes) -> None:
        self._digest = int.from_bytes(data, "little")


class BusyEnvironment(_Busy, Environment):
    """An environment that digests its calls; `beside` most of its observations have a mask and extras."""

    _letter = b"x"
    env_masks = env_extras = False
    env_seed, env_save, env_load = _Busy._seed, _Busy._save, _Busy._load

    def env_init(self) -> str:
        self._mix(b"init")
        return f"task {self._digest}"

    def env_start(self) -> Observation:
        self._mix(b"start")
        return self._shown()

    def env_step(self, action: Action) -> Step:
        self._mix(action.body)
        over = self._digest % 13 == 0
        return Step(self._digest / 7.0, self._shown(), over, over and self._digest % 2 == 0)

    def _shown(self) -> Observation:
        if not self.env_masks or self._digest % 5 == 0:
            return Observation(**self._answer())
        mask = [bool(self._digest >> bit & 1) for bit in range(12)]
        extras: dict[str, Extra] = {"digest": self._digest, "way": (self._digest / 7.0,) * (self._digest % 3)}
        return Observation(**self._answer(), mask=mask, extras=extras)

    def env_cleanup(self) -> None:
        self._mix(b"cleanup")

    def env_message(self, message: str) -> str:
        return message[::-1]


class BusyAgent(_Busy, Agent):
    """An agent that digests its calls, masks included."""

    _letter = b"y"
    agent_masks = False
    _rewards = 0.0
    agent_seed, agent_save, agent_load = _Busy._seed, _Busy._save, _Busy._load

    def agent_init(self, task_spec: str) -> None:
        self._rewards = 0.0
        self._mix(task_spec.encode())

    def agent_start(self, observation: Observation) -> Action:
        self._mix(observation.body)
        return Action(**self._answer())

    def agent_step(self, reward: float, observation: Observation) -> Action:
        self._rewards += reward
        self._mix(repr(reward).encode() + observation.body)
        return Action(**self._answer())

    def agent_end(self, reward: float) -> None:
        self._rewards += reward
        self._mix(repr(reward).encode())

    def agent_cleanup(self) -> None:
        self._mix(b"cleanup")

    def agent_message(self, message: str) -> str:
        return repr(self._rewards) if message == "rewards" else message.upper()


class _Games(BusyEnvironment):
    """Many games, as a batch of observations that the hub does not read."""

    def env_batch(self) -> int:
        return 2

    def env_step(self, action: Action) -> Step:
        return super().env_step(action)._replace(terminal=False, truncated=False)


class _Players(BusyAgent):
    """An agent of many games."""

    def agent_batch(self) -> int:
        return 0


def environment(bulk: int, many: bool, pause: Pause = nothing, beside: bool = False) -> BusyEnvironment:
    """Return an environment, of many games or of one; one may have masks and extras beside observations."""
    made = (_Games if many else BusyEnvironment)(bulk, pause)
    made.env_masks = made.env_extras = beside and not many
    return made


def agent(bulk: int, many: bool, pause: Pause = nothing, beside: bool = False) -> BusyAgent:
    """Return an agent, of many games or of one; one may read masks."""
    made = (_Players if many else BusyAgent)(bulk, pause)
    made.agent_masks = beside and not many
    return made


class Block(NamedTuple):
    """The verbs from RL_init to RL_cleanup: all of them are void if a player is lost meanwhile."""

    seed: int
    styles: tuple[int, ...]
    """Style of each episode: by RL_episode, in steps, in half steps, with saves."""

    steps: int
    """Maximum number of steps of an episode."""


def play(glue: Experiment | _Direct, block: Block, pause: Pause = nothing) -> list[Any]:
    """Play a block, pausing before each step and episode; return all that an experiment can see."""
    seen: list[Any] = [glue.rl_init(block.seed)]
    for style in block.styles:
        pause()
        if style == 0:
            seen += [glue.rl_episode(block.steps), glue.rl_return(), glue.rl_num_steps()]
        elif style == 1:
            start = glue.rl_start()
            seen += [start.observation.body, start.action.body]
            for _ in range(block.steps):
                pause()
                step = glue.rl_step()
                seen += [step.reward, step.terminal, step.observation.body]
                if step.terminal:
                    break
            seen.append(glue.rl_return())
        elif style == 2:
            observation = glue.rl_env_start()
            action = glue.rl_agent_start(observation)
            for _ in range(block.steps):
                pause()
                step = glue.rl_env_step(action)
                seen += [step.reward, step.terminal, step.observation.body]
                if step.terminal and not step.truncated:
                    glue.rl_agent_end(step.reward)
                    break
                action = glue.rl_agent_step(step.reward, step.observation)
                if step.terminal:
                    break
        else:
            seen += [glue.rl_agent_save(), glue.rl_env_save(), glue.rl_episode(block.steps), glue.rl_return()]
    seen += [glue.rl_num_episodes(), glue.rl_agent_message("hello"), glue.rl_env_message("hello")]
    glue.rl_cleanup()
    return seen


def play_timed(glue: Experiment, block: Block, bulk: int, beside: bool, pause: Pause = nothing) -> str:
    """Play a block whose environment does not wait; return what is wrong, or nothing.

    Whatever the agent's actions were, and whichever of them were late: the environment is repeated exactly by
    those that were carried out, and the agent is given each reward once.
    """
    again = environment(bulk, many=False, beside=beside)
    again.env_seed(role_seed(block.seed, Role.ENVIRONMENT))
    if glue.rl_init(block.seed) != again.env_init():
        return "another task spec"
    total = 0.0
    for number, _ in enumerate(block.styles):
        observation, action = glue.rl_start()
        if observation != again.env_start():
            return f"episode {number} starts otherwise"
        for at in range(block.steps):
            pause()
            step, repeated = glue.rl_step(), again.env_step(action)
            if step[:4] != repeated[:4]:
                return f"step {at} of episode {number} is {step[:4]!r:.80}, repeated {repeated[:4]!r:.80}"
            assert step.action is not None
            total, action = total + step.reward, step.action
            if step.terminal:
                break
    given = float(glue.rl_agent_message("rewards"))
    glue.rl_start()  # raises PeerLost if the agent was replaced after the last step, and another has answered
    glue.rl_cleanup()
    again.env_cleanup()
    return "" if math.isclose(given, total) else f"the agent was given {given} of {total}"


class _Direct:
    """RL-Glue's verbs over two objects, without engine or hub."""

    def __init__(self, agent: BusyAgent, environment: BusyEnvironment) -> None:
        self._agent, self._environment = agent, environment
        self.rl_agent_end, self.rl_agent_save = agent.agent_end, agent.agent_save
        self.rl_env_save = environment.env_save
        self.rl_agent_message, self.rl_env_message = agent.agent_message, environment.env_message

    def rl_agent_start(self, observation: Observation) -> Action:
        return self._agent.agent_start(observation.without(extras=True))

    def rl_agent_step(self, reward: float, observation: Observation) -> Action:
        return self._agent.agent_step(reward, observation.without(extras=True))

    def rl_init(self, seed: int) -> str:
        self._environment.env_seed(role_seed(seed, Role.ENVIRONMENT))
        task_spec = self._environment.env_init()
        self._agent.agent_seed(role_seed(seed, Role.AGENT))
        self._agent.agent_init(task_spec)
        self._episodes = 0
        return task_spec

    def rl_env_start(self) -> Observation:
        self._steps, self._total = 1, 0.0
        return self._environment.env_start()

    def rl_start(self) -> Start:
        observation = self.rl_env_start()
        self._action = self.rl_agent_start(observation)
        return Start(observation, self._action)

    def rl_env_step(self, action: Action) -> Step:
        step = self._environment.env_step(action)
        self._total += step.reward
        ended = step.terminal and not step.truncated
        self._episodes += ended
        self._steps += not ended
        return step

    def rl_step(self) -> Step:
        step = self.rl_env_step(self._action)
        if step.terminal and not step.truncated:
            self._agent.agent_end(step.reward)
        else:
            self._action = self.rl_agent_step(step.reward, step.observation)
        return step

    def rl_episode(self, max_steps: int) -> bool:
        self.rl_start()
        while self._steps < max_steps:
            step = self.rl_step()
            if step.terminal:
                return not step.truncated
        return False

    def rl_return(self) -> float:
        return self._total

    def rl_num_steps(self) -> int:
        return self._steps

    def rl_num_episodes(self) -> int:
        return self._episodes

    def rl_cleanup(self) -> None:
        self._environment.env_cleanup()
        self._agent.agent_cleanup()


@cache
def expected(block: Block, bulk: int, many: bool, beside: bool, pace: Pace = WAITING) -> list[Any]:
    """Return the results of a block whose players are called directly, or at a pace."""
    players = agent(bulk, many, beside=beside), environment(bulk, many, beside=beside)
    return play(local(*players, pace=pace) if pace else _Direct(*players), block)
