"""The programs of the original test suites and of the skeleton example, for the original protocol.

Each can be had as a class or function, for tests, and started from a shell:

    python -m tests.system.legacy.legacy_programs agent A1 --port 4096 --style java
    python -m tests.system.legacy.legacy_programs environment E1
    python -m tests.system.legacy.legacy_programs experiment test_1

Source: RL-Glue core 3.04, tests/, and rl-glue-ext, the tests of the C, Java and Python codecs.
"""

from __future__ import annotations

import argparse
import random
import time
from collections.abc import Callable

from tests.system.legacy.legacy_client import (
    STYLES,
    Agent,
    Connection,
    Environment,
    Experiment,
    Numbers,
    serve_agent,
    serve_environment,
)

Checks = list[str]
"""What an experiment program has checked so far, one line each; the first that fails raises."""


def fill(ints: int, doubles: int, chars: int) -> Numbers:
    """The suites' sample numbers: 0, 1, ..; 0/n, 1/n, ..; a, b, .."""
    return Numbers(
        tuple(range(ints)),
        tuple(i / doubles for i in range(doubles)),
        bytes(ord("a") + i for i in range(chars)),
    )


def counted(message: str, counter: int) -> str:
    """The answer of A1 and E1 to a message."""
    return f"{message}|{counter % 3 * f'{counter}.'}|{message}"


class MirrorAgent:
    """A1: does what it sees, and counts its steps."""

    def __init__(self) -> None:
        self.counter = 0

    def init(self, task_spec: str) -> None:
        pass

    def start(self, observation: Numbers) -> Numbers:
        self.counter = 0
        return observation

    def step(self, reward: float, observation: Numbers) -> Numbers:
        self.counter += 1
        return observation

    def end(self, reward: float) -> None:
        pass

    def cleanup(self) -> None:
        pass

    def message(self, message: str) -> str:
        return counted(message, self.counter)


PAST_THE_END = Numbers(
    (173, -173, 2147483647, 0, -2147483648),
    (0.0078125, -0.0078125, 0.0, 0.0078125e150, -0.0078125e150),
    b"gF? &",
)


class FiveStepEnvironment:
    """E1: terminal at its fifth step; a step past that gives extreme numbers."""

    def __init__(self) -> None:
        self.counter = 0

    def init(self) -> str:
        return "sample task spec"

    def start(self) -> Numbers:
        self.counter = 0
        return fill(1, 2, 3)

    def step(self, action: Numbers) -> tuple[float, Numbers, int]:
        if self.counter == 5:
            return -2.0, PAST_THE_END, 0
        observation = Numbers((self.counter,))
        self.counter += 1
        return 1.0, observation, int(self.counter == 5)

    def cleanup(self) -> None:
        pass

    def message(self, message: str) -> str:
        return counted(message, self.counter)


class EmptyAgent:
    """A-empty: empty actions in even episodes."""

    def __init__(self) -> None:
        self.episodes = 0

    def init(self, task_spec: str) -> None:
        self.episodes = 0

    def start(self, observation: Numbers) -> Numbers:
        self.episodes += 1
        return self._action()

    def step(self, reward: float, observation: Numbers) -> Numbers:
        return self._action()

    def _action(self) -> Numbers:
        return fill(7, 3, 1) if self.episodes % 2 else Numbers()

    def end(self, reward: float) -> None:
        pass

    def cleanup(self) -> None:
        pass

    def message(self, message: str) -> str:
        return ""


class EmptyEnvironment:
    """E-empty: empty observations in even episodes, never terminal."""

    def __init__(self) -> None:
        self.episodes = 0

    def init(self) -> str:
        self.episodes = 0
        return ""

    def start(self) -> Numbers:
        self.episodes += 1
        return self._observation()

    def step(self, action: Numbers) -> tuple[float, Numbers, int]:
        return 0.0, self._observation(), 0

    def _observation(self) -> Numbers:
        return fill(2, 4, 5) if self.episodes % 2 else Numbers()

    def cleanup(self) -> None:
        pass

    def message(self, message: str) -> str:
        return ""


def echo(message: str) -> str | None:
    """The answer of A-message and E-message to a message."""
    return {"": "empty", "null": None, "empty": ""}.get(message, message)


class MessageAgent:
    """A-message: answers messages, and does nothing."""

    def init(self, task_spec: str) -> None:
        pass

    def start(self, observation: Numbers) -> Numbers:
        return Numbers()

    def step(self, reward: float, observation: Numbers) -> Numbers:
        return Numbers()

    def end(self, reward: float) -> None:
        pass

    def cleanup(self) -> None:
        pass

    def message(self, message: str) -> str | None:
        return echo(message)


class MessageEnvironment:
    """E-message: answers messages; nothing ever happens in it."""

    def init(self) -> str:
        return ""

    def start(self) -> Numbers:
        return Numbers()

    def step(self, action: Numbers) -> tuple[float, Numbers, int]:
        return 0.0, Numbers(), 0

    def cleanup(self) -> None:
        pass

    def message(self, message: str) -> str | None:
        return echo(message)


class SpeedEnvironment:
    """E-speed: long episodes of small observations and short ones of large, in turn.

    The original's numbers are 5000 steps of 5 ints and 5 doubles, then 200 of 50 000 each.
    """

    def __init__(self, small_steps: int = 5000, large_steps: int = 200, large_size: int = 50_000) -> None:
        self._kinds = ((large_steps, fill(large_size, large_size, 0)), (small_steps, fill(5, 5, 0)))
        self._episodes = 0
        self._steps = 0

    def init(self) -> str:
        self._episodes = 0
        return "sample task spec"

    def start(self) -> Numbers:
        self._episodes += 1
        self._steps = 0
        return Numbers()

    def step(self, action: Numbers) -> tuple[float, Numbers, int]:
        last_step, observation = self._kinds[self._episodes % 2]
        self._steps += 1
        return 1.0, observation, int(self._steps == last_step)

    def cleanup(self) -> None:
        pass

    def message(self, message: str) -> str:
        return ""


class SkeletonAgent:
    """Steps left or right at random."""

    def __init__(self, seed: int = 0) -> None:
        self._random = random.Random(seed)

    def init(self, task_spec: str) -> None:
        pass

    def start(self, observation: Numbers) -> Numbers:
        return Numbers((self._random.randrange(2),))

    def step(self, reward: float, observation: Numbers) -> Numbers:
        return Numbers((self._random.randrange(2),))

    def end(self, reward: float) -> None:
        pass

    def cleanup(self) -> None:
        pass

    def message(self, message: str) -> str:
        return skeleton_answer("agent", message)


class SkeletonEnvironment:
    """A walk over the states 0 to 20 that starts at 10 and ends at either end."""

    TASK_SPEC = (
        "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1.0 OBSERVATIONS INTS (0 20) "
        "ACTIONS INTS (0 1)  REWARDS (-1.0 1.0)  EXTRA skeleton_environment(C/C++) by Brian Tanner."
    )

    def __init__(self) -> None:
        self._state = 10

    def init(self) -> str:
        return self.TASK_SPEC

    def start(self) -> Numbers:
        self._state = 10
        return Numbers((10,))

    def step(self, action: Numbers) -> tuple[float, Numbers, int]:
        self._state += 1 if action.ints[0] == 1 else -1
        reward = {0: -1.0, 20: 1.0}.get(self._state, 0.0)
        return reward, Numbers((self._state,)), int(self._state in (0, 20))

    def cleanup(self) -> None:
        pass

    def message(self, message: str) -> str:
        return skeleton_answer("environment", message)


def skeleton_answer(role: str, message: str) -> str:
    """The skeletons' answer to a message."""
    if message == "what is your name?":
        return f"my name is skeleton_{role}!"
    return "I don't know how to respond to your message"


def check(checks: Checks, what: str, got: object, expected: object) -> None:
    """Note one check.

    Raises:
        AssertionError: `got` is not what was expected.
    """
    assert got == expected, f"{what}: expected {expected!r}, got {got!r}"
    checks.append(what)


def cleanup(experiment: Experiment) -> None:
    """Clean up, if the suite of this language does."""
    if experiment.connection.style.cleans_up:
        experiment.cleanup()


def test_sanity(experiment: Experiment) -> Checks:
    """With A1 and E1; 1 check."""
    checks: Checks = []
    check(checks, "task spec", experiment.init(), "sample task spec")
    experiment.cleanup()
    return checks


def test_1(experiment: Experiment) -> Checks:
    """With A1 and E1: steps to the end and one past it, messages in between; 56 checks."""
    checks: Checks = []
    experiment.init()
    experiment.start()
    rows = (
        ("one", "one|1.|one", "one|1.|one"),
        ("two", "two|2.2.|two", "two|2.2.|two"),
        ("three", "three||three", "three||three"),
        ("four", "four|4.|four", "four|4.|four"),
        ("five", "five|5.5.|five", "five|4.|five"),
    )
    for number, (word, of_environment, of_agent) in enumerate(rows):
        reward, observation, terminal, _ = experiment.step()
        check(checks, f"{word}: reward", reward, 1.0)
        check(checks, f"{word}: terminal", terminal, int(number == 4))
        if number < 4:
            check_counts(checks, word, observation, (1, 0, 0))
            check(checks, f"{word}: int", observation.ints[0], number)
        check(checks, f"{word}: environment's answer", experiment.env_message(word), of_environment)
        check(checks, f"{word}: agent's answer", experiment.agent_message(word), of_agent)
    reward, observation, terminal, _ = experiment.step()
    check(checks, "past the end: reward", reward, -2.0)
    check(checks, "past the end: terminal", terminal, 0)
    check_counts(checks, "past the end", observation, (5, 5, 5))
    for run, got, expected in zip(("ints", "doubles", "chars"), observation, PAST_THE_END, strict=True):
        for number in range(5):
            check(checks, f"past the end: {run} {number}", got[number], expected[number])
    cleanup(experiment)
    return checks


def check_counts(checks: Checks, what: str, numbers: Numbers, expected: tuple[int, int, int]) -> None:
    """Note one check for each of the three counts."""
    for run, got, count in zip(("ints", "doubles", "chars"), numbers.counts, expected, strict=True):
        check(checks, f"{what}: number of {run}", got, count)


def check_episode(
    checks: Checks, experiment: Experiment, max_steps: int, terminal: int, num_steps: int
) -> None:
    """Run one episode; 2 checks."""
    check(checks, f"RL_episode({max_steps})", experiment.episode(max_steps), terminal)
    check(checks, f"steps of RL_episode({max_steps})", experiment.num_steps(), num_steps)


def test_rl_episode(experiment: Experiment) -> Checks:
    """With A1 and E1: episodes with and without a limit; 14 checks."""
    checks: Checks = []
    experiment.init()
    check_episode(checks, experiment, 0, 1, 5)
    check_episode(checks, experiment, 1, 0, 1)
    check_episode(checks, experiment, 2, 0, 2)
    check_episode(checks, experiment, 4, 0, 4)
    check_episode(checks, experiment, 5, 0, 5)
    check_episode(checks, experiment, 6, 1, 5)
    check_episode(checks, experiment, 7, 1, 5)
    cleanup(experiment)
    return checks


def test_init_cleanup(experiment: Experiment) -> Checks:
    """With A1 and E1: the same in three runs, cleaned up once or twice; 14 checks."""
    checks: Checks = []
    experiment.init()
    check_episode(checks, experiment, 0, 1, 5)
    check_episode(checks, experiment, 1, 0, 1)
    experiment.cleanup()
    experiment.init()
    check_episode(checks, experiment, 2, 0, 2)
    check_episode(checks, experiment, 4, 0, 4)
    check_episode(checks, experiment, 5, 0, 5)
    experiment.cleanup()
    experiment.cleanup()
    experiment.init()
    check_episode(checks, experiment, 6, 1, 5)
    check_episode(checks, experiment, 7, 1, 5)
    experiment.cleanup()
    return checks


def test_empty(experiment: Experiment) -> Checks:
    """With A-empty and E-empty: empty observations and actions; 184 checks."""
    checks: Checks = []
    experiment.init()
    for episode in range(1, 5):
        of_action, of_observation = ((7, 3, 1), (2, 4, 5)) if episode % 2 else ((0, 0, 0), (0, 0, 0))
        observation, action = experiment.start()
        check_counts(checks, f"start of {episode}: action", action, of_action)
        check_counts(checks, f"start of {episode}: observation", observation, of_observation)
        for step in range(5):
            reward, observation, terminal, action = experiment.step()
            where = f"step {step} of {episode}"
            check(checks, f"{where}: terminal", terminal, 0)
            check(checks, f"{where}: reward", reward, 0.0)
            check_counts(checks, f"{where}: action", action, of_action)
            check_counts(checks, f"{where}: observation", observation, of_observation)
    cleanup(experiment)
    return checks


def test_message(experiment: Experiment) -> Checks:
    """With A-message and E-message: empty, short and long messages; 14 checks."""
    checks: Checks = []
    experiment.init()
    of_environment = "2" + 55 * "1" + "3" + 55 * "1" + "3"
    of_agent = "4" + 55 * "5" + "6" + 55 * "5" + "9"
    for send, message, expected in (
        (experiment.env_message, None, "empty"),
        (experiment.env_message, "", "empty"),
        (experiment.agent_message, None, "empty"),
        (experiment.agent_message, "", "empty"),
        (experiment.env_message, "empty", ""),
        (experiment.agent_message, "empty", ""),
        (experiment.env_message, "null", ""),
        (experiment.agent_message, "null", ""),
        (experiment.env_message, "1", "1"),
        (experiment.agent_message, "1", "1"),
        (experiment.env_message, "1000000000000000000000", "1000000000000000000000"),
        (experiment.agent_message, "1000000000000000000000", "1000000000000000000000"),
        (experiment.env_message, of_environment, of_environment),
        (experiment.agent_message, of_agent, of_agent),
    ):
        check(checks, f"answer to {message!r}", send(message), expected)
    cleanup(experiment)
    return checks


def test_speed(experiment: Experiment) -> Checks:
    """With A1 and E-speed: prints the seconds of a large and a small episode; no checks."""
    experiment.init()
    experiment.episode(500)
    for size in ("large", "small"):
        begun = time.perf_counter()
        experiment.episode(0)
        elapsed = time.perf_counter() - begun
        print(f"{size} observations: {experiment.num_steps()} steps in {elapsed:.3f} s")
    experiment.cleanup()
    return []


def skeleton(experiment: Experiment) -> Checks:
    """The skeleton example, with what must hold however the agent walks."""
    checks: Checks = []
    check(checks, "task spec", "skeleton_environment" in experiment.init(), True)
    for role, send in (("agent", experiment.agent_message), ("environment", experiment.env_message)):
        for message, expected in (
            ("what is your name?", f"my name is skeleton_{role}"),
            ("If at first you don't succeed; call it version 1.0", "I don't know how to respond"),
        ):
            check(checks, f"{role}: {message}", send(message)[: len(expected)], expected)
    for max_steps in (100, 100, 100, 100, 100, 1, 0):
        terminal = experiment.episode(max_steps)
        check_walk(checks, experiment, f"RL_episode({max_steps})", terminal, max_steps)
    experiment.cleanup()
    experiment.init()
    experiment.start()
    terminal = 0
    while not terminal:
        _, _, terminal, _ = experiment.step()
    check_walk(checks, experiment, "steps", terminal, 0)
    experiment.cleanup()
    return checks


def check_walk(checks: Checks, experiment: Experiment, what: str, terminal: int, max_steps: int) -> None:
    """Check what must hold of a walk that ended, or was cut off at `max_steps`."""
    episode_return = experiment.episode_return()
    num_steps = experiment.num_steps()
    if terminal:
        check(checks, f"{what}: {num_steps} steps", num_steps >= 10 and num_steps % 2 == 0, True)
        check(checks, f"{what}: return", abs(episode_return), 1.0)
    else:
        check(checks, f"{what}: steps", num_steps, max_steps)
        check(checks, f"{what}: return", episode_return, 0.0)


AGENTS: dict[str, Callable[[], Agent]] = {
    "A1": MirrorAgent,
    "A-empty": EmptyAgent,
    "A-message": MessageAgent,
    "skeleton": SkeletonAgent,
}
ENVIRONMENTS: dict[str, Callable[[], Environment]] = {
    "E1": FiveStepEnvironment,
    "E-empty": EmptyEnvironment,
    "E-message": MessageEnvironment,
    "E-speed": SpeedEnvironment,
    "skeleton": SkeletonEnvironment,
}
EXPERIMENTS: dict[str, Callable[[Experiment], Checks]] = {
    "test_sanity": test_sanity,
    "test_1": test_1,
    "test_rl_episode": test_rl_episode,
    "test_init_cleanup": test_init_cleanup,
    "test_empty": test_empty,
    "test_message": test_message,
    "test_speed": test_speed,
    "skeleton": skeleton,
}
CASES = {
    "test_sanity": ("A1", "E1"),
    "test_1": ("A1", "E1"),
    "test_rl_episode": ("A1", "E1"),
    "test_init_cleanup": ("A1", "E1"),
    "test_empty": ("A-empty", "E-empty"),
    "test_message": ("A-message", "E-message"),
    "test_speed": ("A1", "E-speed"),
    "skeleton": ("skeleton", "skeleton"),
}
"""The agent and the environment that each experiment is made for."""


def main() -> None:
    parser = argparse.ArgumentParser(description="Run a program of the original test suites.")
    parser.add_argument("role", choices=("agent", "environment", "experiment"))
    parser.add_argument("name", choices=sorted({*AGENTS, *ENVIRONMENTS, *EXPERIMENTS}))
    parser.add_argument("--port", type=int, default=4096)
    parser.add_argument("--host", default="127.0.0.1")
    parser.add_argument("--style", choices=sorted(STYLES), default="c")
    parser.add_argument("--small-steps", type=int, default=5000, help="E-speed: steps of a small episode")
    parser.add_argument("--large-steps", type=int, default=200, help="E-speed: steps of a large episode")
    parser.add_argument("--large-size", type=int, default=50_000, help="E-speed: ints, doubles when large")
    arguments = parser.parse_args()
    connection = Connection(arguments.port, STYLES[arguments.style], arguments.host)
    if arguments.role == "agent":
        serve_agent(AGENTS[arguments.name](), connection)
    elif arguments.role == "environment":
        environment = ENVIRONMENTS[arguments.name]()
        if arguments.name == "E-speed":
            environment = SpeedEnvironment(arguments.small_steps, arguments.large_steps, arguments.large_size)
        serve_environment(environment, connection)
    else:
        experiment = Experiment(connection)
        print(f"{arguments.name}: {len(EXPERIMENTS[arguments.name](experiment))} checks passed")
        experiment.close()


if __name__ == "__main__":
    main()
