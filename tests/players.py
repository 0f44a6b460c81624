"""Agents and environments for tests: the scripted ones record their calls and are easily configured."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable

from glue.batches import read_batch_task_spec
from glue.engine.experiment import Experiment
from glue.plugins.loading import names
from glue.roles import Agent, Environment
from glue.types import Action, Observation, Step
from glue.wire.messages import Role

WITH_EXTRAS = ("chat", "mcp", "sb3", "soar")
"""Name prefixes of players that need more than the tests have; those players have tests of their own."""

Hook = Callable[[str], None]


def installed(role: Role) -> list[str]:
    """Return the names of all agents or environments, except those that need an extra."""
    return [name for name in names(role) if not name.startswith(WITH_EXTRAS)]


def outcomes(glue: Experiment, episodes: int, max_steps: int = 0) -> list[tuple[float, int]]:
    """Play episodes; return the return and the number of steps of each."""
    found = []
    for _ in range(episodes):
        glue.rl_episode(max_steps)
        found.append((glue.rl_return(), glue.rl_num_steps()))
    return found


def returns(glue: Experiment, episodes: int, max_steps: int = 0) -> list[float]:
    """Run episodes; return the return of each."""
    return [episode_return for episode_return, _ in outcomes(glue, episodes, max_steps)]


def nothing(call: str) -> None:
    """Do nothing."""


def failing(at: str, error: BaseException) -> Hook:
    """Return a hook that raises `error` at a call."""

    def fail(call: str) -> None:
        if call.startswith(at):
            raise error

    return fail


class At:
    """A hook that acts once: when the call `call` comes for the `count`th time."""

    def __init__(self, call: str, count: int, act: Callable[[], None]) -> None:
        self._call = call
        self._left = count
        self._act = act

    def __call__(self, call: str) -> None:
        if call.startswith(self._call):
            self._left -= 1
            if self._left == 0:
                self._act()


class ScriptedEnvironment(Environment):
    """Shows the number of steps, rewards each step with `reward`, and ends at step `length`.

    While `cuts` is set, episodes do not end there but are cut off.
    `calls` receives one line per call; the agent may share the list, which then shows the order of all
    calls. `before` is called with each line first, so that a test can act at that point.
    """

    cuts = False

    def __init__(
        self, length: int = 3, reward: float = 1.0, calls: list[str] | None = None, before: Hook = nothing
    ) -> None:
        self.calls: list[str] = [] if calls is None else calls
        self.length = length
        self.reward = reward
        self.task_spec = "a task"
        self.before = before
        self._steps = 0

    def _note(self, call: str) -> None:
        self.before(call)
        self.calls.append(call)

    def env_init(self) -> str:
        self._note("env_init")
        return self.task_spec

    def env_start(self) -> Observation:
        self._note("env_start")
        self._steps = 0
        return Observation(ints=[0])

    def env_step(self, action: Action) -> tuple[float, Observation, bool] | Step:
        self._note(f"env_step {action.ints.tolist()}")
        self._steps += 1
        step = self.reward, Observation(ints=[self._steps]), self._steps >= self.length
        return Step(*step, truncated=step[2]) if self.cuts else step

    def env_cleanup(self) -> None:
        self._note("env_cleanup")

    def env_message(self, message: str) -> str:
        self._note(f"env_message {message}")
        return f"environment heard {message}"


class ScriptedAgent(Agent):
    """Answers an observation of one int n with the action n + 100; records calls as the environment does."""

    def __init__(self, calls: list[str] | None = None, before: Hook = nothing) -> None:
        self.calls: list[str] = [] if calls is None else calls
        self.before = before

    def _note(self, call: str) -> None:
        self.before(call)
        self.calls.append(call)

    def agent_init(self, task_spec: str) -> None:
        self._note(f"agent_init {task_spec}")

    def agent_start(self, observation: Observation) -> Action:
        self._note(f"agent_start {observation.ints.tolist()}")
        return Action(ints=observation.ints + 100)

    def agent_step(self, reward: float, observation: Observation) -> Action:
        self._note(f"agent_step {reward:g} {observation.ints.tolist()}")
        return Action(ints=observation.ints + 100)

    def agent_end(self, reward: float) -> None:
        self._note(f"agent_end {reward:g}")

    def agent_cleanup(self) -> None:
        self._note("agent_cleanup")

    def agent_message(self, message: str) -> str:
        self._note(f"agent_message {message}")
        return f"agent heard {message}"


class ActingInAll(Agent):
    """An agent that acts in many games at once."""

    games = 0

    def agent_batch(self) -> int:
        return 0

    def agent_init(self, task_spec: str) -> None:
        self.games, _ = read_batch_task_spec(task_spec)

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return self.agent_start(observation)

    def agent_end(self, reward: float) -> None:
        raise AssertionError("a batch has no end")

    def agent_cleanup(self) -> None:
        self.games = 0


class SeededEnvironment(ScriptedEnvironment):
    """With the capability `seed`."""

    def env_seed(self, seed: int) -> None:
        self._note(f"env_seed {seed}")


class SeededAgent(ScriptedAgent):
    """With the capability `seed`."""

    def agent_seed(self, seed: int) -> None:
        self._note(f"agent_seed {seed}")


class TellingAgent(SeededAgent):
    """Answers a message with the calls received before it."""

    def agent_message(self, message: str) -> str:
        return "\n".join(self.calls)


class TellingEnvironment(SeededEnvironment):
    """Answers a message with the calls received before it."""

    def env_message(self, message: str) -> str:
        return "\n".join(self.calls)


class ChainEnvironment(Environment):
    """Each reward depends on every earlier call, so an extra or a missing call changes the return."""

    def __init__(self) -> None:
        self._chain = 0
        self._steps = 0

    def _add(self, data: bytes) -> int:
        self._chain = zlib.crc32(data, self._chain)
        return self._chain

    def env_init(self) -> str:
        self._chain = 0
        return "chain"

    def env_start(self) -> Observation:
        self._steps = 0
        return Observation(ints=[self._add(b"start") >> 1])

    def env_step(self, action: Action) -> tuple[float, Observation, bool]:
        self._steps += 1
        link = self._add(action.body)
        return link / 8, Observation(ints=[link >> 1], chars=bytes(link % 200)), self._steps == 20

    def env_message(self, message: str) -> str:
        return str(self._add(message.encode()))


class ChainAgent(Agent):
    """Each action depends on every earlier call."""

    def __init__(self) -> None:
        self._chain = 0

    def _act(self, data: bytes) -> Action:
        self._chain = zlib.crc32(data, self._chain)
        return Action(ints=[self._chain >> 1])

    def agent_init(self, task_spec: str) -> None:
        self._chain = 0

    def agent_start(self, observation: Observation) -> Action:
        return self._act(observation.body)

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return self._act(observation.body + struct.pack("<d", reward))

    def agent_end(self, reward: float) -> None:
        self._act(struct.pack("<d", reward))

    def agent_message(self, message: str) -> str:
        return str(self._act(message.encode()).ints[0])
