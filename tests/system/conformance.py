"""The agents, environments and experiments of RL-Glue's own test suites, as programs of this project.

A scenario pairs an agent and an environment with an experiment, a function of `Experiment` that checks
what the original suite checks and returns all that it saw, so that two ways to run it can be compared.

Source: RL-Glue core 3.04, tests/, and rl-glue-ext, the tests of the C, Java and Python codecs.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, Final

import numpy as np

from agents.baselines import SkeletonAgent
from env_server.toys import SkeletonEnvironment
from glue import Action, Agent, Environment, Experiment, Observation, Step

Seen = list[Any]

SAMPLE_SPEC: Final = "sample task spec"
ENDLESS: Final = Observation(
    ints=[173, -173, 2147483647, 0, -2147483648],
    doubles=[0.0078125, -0.0078125, 0.0, 0.0078125e150, -0.0078125e150],
    chars=b"gF? &",
)
"""The observation of E1 past the end: extreme values, which must arrive exactly."""


@lru_cache
def fill(ints: int, doubles: int, chars: int) -> bytes:
    """Return the suites' sample numbers, as a body: 0, 1, ..; 0/n, 1/n, ..; a, b, .."""
    letters = bytes(ord("a") + i for i in range(chars))
    return Observation(np.arange(ints), np.arange(doubles) / max(doubles, 1), letters).body


def counted(message: str, counter: int) -> str:
    """Return the answer of A1 and E1 to a message."""
    return f"{message}|{counter % 3 * f'{counter}.'}|{message}"


class MirrorAgent(Agent):
    """A1: repeats its observations as actions, and counts its steps."""

    def __init__(self) -> None:
        self._counter = 0

    def agent_start(self, observation: Observation) -> Action:
        self._counter = 0
        return Action.from_body(observation.body)

    def agent_step(self, reward: float, observation: Observation) -> Action:
        self._counter += 1
        return Action.from_body(observation.body)

    def agent_message(self, message: str) -> str:
        return counted(message, self._counter)


class FiveStepEnvironment(Environment):
    """E1: five steps, then the extreme values at any further step."""

    def __init__(self) -> None:
        self._counter = 0

    def env_init(self) -> str:
        return SAMPLE_SPEC

    def env_start(self) -> Observation:
        self._counter = 0
        return Observation.from_body(fill(1, 2, 3))

    def env_step(self, action: Action) -> tuple[float, Observation, bool]:
        if self._counter == 5:
            return -2.0, ENDLESS, False
        self._counter += 1
        return 1.0, Observation(ints=[self._counter - 1]), self._counter == 5

    def env_message(self, message: str) -> str:
        return counted(message, self._counter)


class EmptyAgent(Agent):
    """A-empty: an empty action in even episodes, 7/3/1 numbers in odd ones."""

    def __init__(self) -> None:
        self._episode = 0

    def agent_init(self, task_spec: str) -> None:
        self._episode = 0

    def agent_start(self, observation: Observation) -> Action:
        self._episode += 1
        return self.agent_step(0.0, observation)

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return Action.from_body(fill(7, 3, 1) if self._episode % 2 else fill(0, 0, 0))


class EmptyEnvironment(Environment):
    """E-empty: an empty observation in even episodes, 2/4/5 numbers in odd ones; never ends."""

    def __init__(self) -> None:
        self._episode = 0

    def env_init(self) -> str:
        self._episode = 0
        return ""

    def env_start(self) -> Observation:
        self._episode += 1
        return self._observation()

    def env_step(self, action: Action) -> tuple[float, Observation, bool]:
        return 0.0, self._observation(), False

    def _observation(self) -> Observation:
        return Observation.from_body(fill(2, 4, 5) if self._episode % 2 else fill(0, 0, 0))


def answer(message: str) -> str:
    """Return the answer of A-message and E-message; a null answer becomes the empty text on its way."""
    if message == "null":
        return None  # type: ignore[return-value]
    return {"": "empty", "empty": ""}.get(message, message)


class MessageAgent(MirrorAgent):
    """A-message: only its messages count."""

    def agent_message(self, message: str) -> str:
        return answer(message)


class MessageEnvironment(FiveStepEnvironment):
    """E-message: only its messages count."""

    def env_message(self, message: str) -> str:
        return answer(message)


class SpeedEnvironment(Environment):
    """E-speed: 5000 steps of 5 + 5 numbers in odd episodes, 200 of 50 000 + 50 000 in even ones."""

    def __init__(self) -> None:
        self._episode = 0
        self._step = 0

    def env_init(self) -> str:
        self._episode = 0
        return SAMPLE_SPEC

    def env_start(self) -> Observation:
        self._episode += 1
        self._step = 0
        return Observation()

    def env_step(self, action: Action) -> tuple[float, Observation, bool]:
        self._step += 1
        count, end = (5, 5000) if self._episode % 2 else (50_000, 200)
        return 1.0, Observation.from_body(fill(count, count, 0)), self._step == end


def sanity(glue: Experiment) -> Seen:
    """test_sanity: the task spec arrives."""
    task_spec = glue.rl_init()
    assert task_spec == SAMPLE_SPEC
    glue.rl_cleanup()
    return [task_spec]


def one(glue: Experiment) -> Seen:
    """test_1: five steps with messages between them, then one past the end."""
    seen: Seen = [glue.rl_init(), glue.rl_start()]
    answers = {
        "one": ("one|1.|one", "one|1.|one"),
        "two": ("two|2.2.|two", "two|2.2.|two"),
        "three": ("three||three", "three||three"),
        "four": ("four|4.|four", "four|4.|four"),
        # The terminal step did not call agent_step, so the agent's counter stays.
        "five": ("five|5.5.|five", "five|4.|five"),
    }
    for count, (text, (from_environment, from_agent)) in enumerate(answers.items()):
        reward, observation, terminal, _, action = result = glue.rl_step()
        assert (reward, observation, terminal) == (1.0, Observation(ints=[count]), count == 4)
        assert action == Action(ints=[min(count, 3)])
        assert glue.rl_env_message(text) == from_environment
        assert glue.rl_agent_message(text) == from_agent
        seen += [result, from_environment, from_agent]
    past_the_end = glue.rl_step()
    assert past_the_end == Step(-2.0, ENDLESS, False, action=Action.from_body(ENDLESS.body))
    glue.rl_cleanup()
    return [*seen, past_the_end]


EPISODES: Final = {
    0: (True, 5),
    1: (False, 1),
    2: (False, 2),
    4: (False, 4),
    5: (False, 5),
    6: (True, 5),
    7: (True, 5),
}
"""test_rl_episode: for each limit, whether the end is reached, and after how many steps."""


def episodes(glue: Experiment, limits: list[int]) -> Seen:
    seen: Seen = []
    for limit in limits:
        outcome = glue.rl_episode(limit), glue.rl_num_steps()
        assert outcome == EPISODES[limit], f"RL_episode({limit})"
        seen += [*outcome, glue.rl_num_episodes(), glue.rl_return()]
    return seen


def rl_episode(glue: Experiment) -> Seen:
    """test_rl_episode."""
    glue.rl_init()
    seen = episodes(glue, list(EPISODES))
    glue.rl_cleanup()
    return seen


def init_cleanup(glue: Experiment) -> Seen:
    """test_init_cleanup: the same in three runs, with a doubled cleanup."""
    glue.rl_init()
    seen = episodes(glue, [0, 1])
    glue.rl_cleanup()
    glue.rl_init()
    seen += episodes(glue, [2, 4, 5])
    glue.rl_cleanup()
    glue.rl_cleanup()
    glue.rl_init()
    seen += episodes(glue, [6, 7])
    glue.rl_cleanup()
    return seen


def empty(glue: Experiment) -> Seen:
    """test_empty: four episodes, alternately full and empty."""
    seen: Seen = [glue.rl_init()]
    for episode in range(1, 5):
        observed, acted = ((2, 4, 5), (7, 3, 1)) if episode % 2 else ((0, 0, 0), (0, 0, 0))
        start = glue.rl_start()
        assert (start.observation.counts, start.action.counts) == (observed, acted)
        seen.append(start)
        for _ in range(5):
            result = glue.rl_step()
            assert (result.reward, result.terminal) == (0.0, False)
            assert (result.observation.counts, result.action.counts) == (observed, acted)
            seen.append(result)
    glue.rl_cleanup()
    return seen


def message(glue: Experiment) -> Seen:
    """test_message."""
    seen: Seen = [glue.rl_init()]
    long = ["2" + "1" * 55 + "3" + "1" * 55 + "3", "4" + "5" * 55 + "6" + "5" * 55 + "9"]
    for text in ["", "empty", "null", "1", "1000000000000000000000", *long]:
        expected = {"": "empty", "empty": "", "null": ""}.get(text, text)
        for ask in (glue.rl_env_message, glue.rl_agent_message):
            assert ask(text) == expected
            seen.append(expected)
    glue.rl_cleanup()
    return seen


def speed(glue: Experiment) -> Seen:
    """test_speed: many small steps, and some very large ones."""
    seen: Seen = [glue.rl_init()]
    for limit in (500, 0, 0):
        seen += [glue.rl_episode(limit), glue.rl_num_steps(), glue.rl_return()]
    assert seen == [SAMPLE_SPEC, False, 500, 499.0, True, 200, 200.0, True, 5000, 5000.0]
    glue.rl_cleanup()
    return seen


def skeleton(glue: Experiment) -> Seen:
    """The skeleton example of every codec: a random walk."""
    seen: Seen = [glue.rl_init(seed=1)]
    names = "my name is skeleton_agent!", "my name is skeleton_environment!"
    unknown = "I don't know how to respond to your message"
    for text, expected in (
        ("what is your name?", names),
        ("If at first you don't succeed; call it version 1.0", (unknown, unknown)),
    ):
        assert (glue.rl_agent_message(text), glue.rl_env_message(text)) == expected
    for limit in (100, 100, 100, 100, 100, 1, 0):
        ended, steps, total = glue.rl_episode(limit), glue.rl_num_steps(), glue.rl_return()
        if ended:
            assert total in (-1.0, 1.0)
            assert steps >= 10
            assert steps % 2 == 0, "both ends are an even number of steps away"
        else:
            assert (steps, total) == (limit, 0.0)
        seen += [ended, steps, total]
    glue.rl_cleanup()
    glue.rl_init()
    seen.append(glue.rl_start())
    terminal = False
    while not terminal:
        result = glue.rl_step()
        reward, terminal = result.reward, bool(result.terminal)
        seen.append(result)
    assert (glue.rl_num_episodes(), glue.rl_return()) == (1, reward)
    glue.rl_cleanup()
    return seen


@dataclass(frozen=True)
class Scenario:
    """One case: the two players, and the experiment."""

    agent: Callable[[], Any]
    environment: Callable[[], Any]
    run: Callable[[Experiment], Seen]


SCENARIOS: Final = {
    "test_sanity": Scenario(MirrorAgent, FiveStepEnvironment, sanity),
    "test_1": Scenario(MirrorAgent, FiveStepEnvironment, one),
    "test_rl_episode": Scenario(MirrorAgent, FiveStepEnvironment, rl_episode),
    "test_init_cleanup": Scenario(MirrorAgent, FiveStepEnvironment, init_cleanup),
    "test_empty": Scenario(EmptyAgent, EmptyEnvironment, empty),
    "test_message": Scenario(MessageAgent, MessageEnvironment, message),
    "test_speed": Scenario(MirrorAgent, SpeedEnvironment, speed),
    "skeleton": Scenario(SkeletonAgent, SkeletonEnvironment, skeleton),
}


def agents() -> dict[str, Any]:
    """Return one agent for each scenario, by the scenario's name."""
    return {name: scenario.agent() for name, scenario in SCENARIOS.items()}


def environments() -> dict[str, Any]:
    """Return one environment for each scenario, by the scenario's name."""
    return {name: scenario.environment() for name, scenario in SCENARIOS.items()}
