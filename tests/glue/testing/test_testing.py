"""Contract checks: glue/testing.py. Each rule is broken by a player made for it, and found by name."""

from __future__ import annotations

import math
import random
import struct
import subprocess
import sys
from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
import pytest

from glue.errors import GlueError, LocalProtocolError, SimulatorError
from glue.random_state import load_generator, save_generator
from glue.roles import Agent, Environment
from glue.testing import ContractBroken, Rule, check_agent, check_environment
from glue.types import Action, Observation

TASK_SPEC = (
    "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1.0 OBSERVATIONS INTS (0 9) DOUBLES (0 1) "
    "ACTIONS INTS (0 1) REWARDS (-1 0) EXTRA corridor"
)


class Corridor(Environment):
    """Ten fields in a row, from a random one to the last; each observed with a random number."""

    task_spec = TASK_SPEC

    def __init__(self) -> None:
        self.generator = np.random.default_rng(0)
        self.field: int | None = None
        self.starts = 0
        self.ready = False

    def env_seed(self, seed: int) -> None:
        self.generator = np.random.default_rng(seed)

    def env_init(self) -> str:
        self.starts = 0
        self.ready = True
        self.field = None
        return self.task_spec

    def env_start(self) -> Observation:
        self.starts += 1
        self.field = int(self.generator.integers(9))
        return self.observe()

    def env_step(self, action: Action) -> tuple[float, Observation, bool]:
        assert self.field is not None
        self.field = max(0, self.field + (1 if action.ints[0] else -1))
        terminal = self.field == 9
        return float(terminal) - 1, self.observe(), terminal

    def env_cleanup(self) -> None:
        self.ready = False

    def env_message(self, message: str) -> str:
        return f"the corridor heard {message}"

    def env_save(self) -> bytes:
        return save_generator(self.generator)

    def env_load(self, data: bytes) -> None:
        self.generator = load_generator(data)

    def observe(self) -> Observation:
        assert self.field is not None
        return Observation([self.field], [self.generator.random()])


class Wanderer(Agent):
    """Acts at random, more to the right the more it has been rewarded."""

    def __init__(self) -> None:
        self.generator = np.random.default_rng(0)
        self.learned = 0.0
        self.ready = False
        self.acting = False

    def agent_seed(self, seed: int) -> None:
        self.generator = np.random.default_rng(seed)

    def agent_init(self, task_spec: str) -> None:
        self.learned = 0.0
        self.ready = True
        self.acting = False

    def agent_start(self, observation: Observation) -> Action:
        self.acting = True
        return self.act()

    def agent_step(self, reward: float, observation: Observation) -> Action:
        self.learned += 0.01 * reward
        return self.act()

    def agent_end(self, reward: float) -> None:
        self.learned += 0.01 * reward
        self.acting = False

    def agent_cleanup(self) -> None:
        self.ready = False

    def agent_message(self, message: str) -> str:
        return f"the wanderer heard {message}"

    def agent_save(self) -> bytes:
        return struct.pack("<d", self.learned) + save_generator(self.generator)

    def agent_load(self, data: bytes) -> None:
        if len(data) < 8:
            raise LocalProtocolError("a save of the wanderer begins with 8 bytes")
        (self.learned,) = struct.unpack_from("<d", data)
        self.generator = load_generator(data[8:])

    def act(self) -> Action:
        return Action([int(self.generator.random() < math.exp(self.learned))])


_P = TypeVar("_P", Corridor, Wanderer)


def broken(player: type[_P], **members: Any) -> type[_P]:
    """Return a class of players of which some members are replaced."""
    return type("Broken", (player,), members)


def caught(check: Callable[[], None]) -> ContractBroken:
    with pytest.raises(ContractBroken) as error:
        check()
    return error.value


# Players that keep the rules


def test_good_players_keep_every_rule() -> None:
    check_environment(Corridor)
    check_agent(Wanderer, TASK_SPEC)


@pytest.mark.parametrize(("episodes", "steps", "seed"), [(1, 1, 1), (5, 20, 2)])
def test_rounds_may_be_of_any_length(episodes: int, steps: int, seed: int) -> None:
    check_environment(Corridor, episodes=episodes, steps=steps, seed=seed)
    check_agent(Wanderer, TASK_SPEC, episodes=episodes, steps=steps, seed=seed)


class PlainCorridor(Corridor):
    """Offers nothing beyond the role, and begins differently with each state of the global generator."""

    env_seed = env_save = env_load = None  # type: ignore[assignment]

    def env_init(self) -> str:
        self.generator = np.random.default_rng(random.getrandbits(32))
        return super().env_init()


class PlainWanderer(Wanderer):
    """Offers nothing beyond the role, and begins differently with each state of the global generator."""

    agent_seed = agent_save = agent_load = None  # type: ignore[assignment]

    def agent_init(self, task_spec: str) -> None:
        self.generator = np.random.default_rng(random.getrandbits(32))
        super().agent_init(task_spec)


def test_capabilities_need_not_be_offered() -> None:
    check_environment(PlainCorridor)
    check_agent(PlainWanderer, TASK_SPEC)


@pytest.mark.parametrize("task_spec", ["", "a corridor", "VERSION Corridor-1 fields=10"])
def test_private_task_spec_needs_a_partner(task_spec: str) -> None:
    Private = broken(Corridor, task_spec=task_spec)
    with pytest.raises(LocalProtocolError, match="give check_environment `action`"):
        check_environment(Private)
    check_environment(Private, action=lambda generator: Action(generator.integers(2, size=1)))
    with pytest.raises(LocalProtocolError, match="give check_agent `observation`"):
        check_agent(Wanderer, task_spec)
    check_agent(Wanderer, task_spec, observation=lambda generator: Observation(doubles=generator.random(2)))


@pytest.mark.parametrize("check", [check_environment, lambda made: check_agent(made, TASK_SPEC)])
@pytest.mark.parametrize("made", [Corridor(), Wanderer()])
def test_an_object_in_place_of_its_class_is_refused(check: Callable[[Any], None], made: object) -> None:
    with pytest.raises(LocalProtocolError, match=f"needs the class.*{type(made).__name__}"):
        check(made)


def test_numpy_numbers_are_numbers() -> None:
    def step(player: Corridor, action: Action) -> Any:
        reward, observation, terminal = Corridor.env_step(player, action)
        return np.float64(reward), observation, np.bool_(terminal)

    check_environment(broken(Corridor, env_step=step))


def test_error_names_rule_call_and_answer() -> None:
    error = caught(lambda: check_environment(broken(Corridor, env_message=lambda player, message: None)))
    assert error.rule is Rule.MESSAGE
    assert str(error) == "a message is answered with a text: env_message returned None, of type NoneType"
    assert isinstance(error, GlueError)
    assert isinstance(error, AssertionError)


def test_no_test_framework_is_needed() -> None:
    program = "import sys, glue.testing; sys.exit('pytest' in sys.modules or '_pytest' in sys.modules)"
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60)


# Players that break one rule


def raising(condition: Callable[[Any], bool], method: str, player: type[Any]) -> Callable[..., Any]:
    """Return a method that raises if the condition of its player holds, and else does what it did."""

    def checked(self: Any, *arguments: Any) -> Any:
        if condition(self):
            raise SimulatorError("not now")
        return getattr(player, method)(self, *arguments)

    return checked


def stepping(change: Callable[[float, Observation, bool], Any]) -> Callable[..., Any]:
    """Return a step whose answer is changed."""
    return lambda self, action: change(*Corridor.env_step(self, action))


class CleansUpOnce(Corridor):
    taken: str | None = "a window"

    def env_init(self) -> str:
        self.taken = "a window"
        return super().env_init()

    def env_cleanup(self) -> None:
        assert self.taken
        self.taken = None


class Unseeded(Corridor):
    def __init__(self) -> None:
        super().__init__()
        self.noise = np.random.default_rng()

    def observe(self) -> Observation:
        return Observation(super().observe().ints, [self.noise.random()])


class Remembers(Corridor):
    """With every start, even after an init, an episode begins nearer the end."""

    def env_init(self) -> str:
        starts = self.starts
        text = super().env_init()
        self.starts = starts
        return text

    def env_start(self) -> Observation:
        super().env_start()
        self.field = min(self.starts, 8)
        return self.observe()


def load_only_whole(self: Corridor, data: bytes) -> None:
    if len(data) == len(self.env_save()):
        Corridor.env_load(self, data)


def load_unless_empty(self: Corridor, data: bytes) -> None:
    if data:
        Corridor.env_load(self, data)


def never_again(self: Corridor) -> None:
    if self.ready:
        self.generator = None  # type: ignore[assignment]


BROKEN_ENVIRONMENTS: dict[str, tuple[Rule, type[Corridor]]] = {
    "cannot start": (Rule.METHODS, broken(Corridor, env_start=None)),
    "speaks only when ready": (
        Rule.CALLS,
        broken(Corridor, env_message=raising(lambda self: not self.ready, "env_message", Corridor)),
    ),
    "speaks only in episodes": (
        Rule.CALLS,
        broken(Corridor, env_message=lambda self, message: f"at {self.observe()}"),
    ),
    "cleans up only what init took": (Rule.CALLS, broken(CleansUpOnce, taken=None)),
    "cleans up once": (Rule.CALLS, CleansUpOnce),
    "inits once": (
        Rule.CALLS,
        broken(Corridor, env_init=raising(lambda self: self.ready, "env_init", Corridor)),
    ),
    "never inits again": (
        Rule.CALLS,
        broken(Corridor, env_cleanup=never_again, env_seed=lambda self, seed: self.generator.integers(1)),
    ),
    "starts only after the end": (
        Rule.CALLS,
        broken(Corridor, env_start=raising(lambda self: self.field not in (None, 9), "env_start", Corridor)),
    ),
    "too large for int32": (
        Rule.CALLS,
        broken(Corridor, env_step=lambda self, action: (0.0, Observation([2**31]), False)),
    ),
    "bytes for a task spec": (Rule.TASK_SPEC, broken(Corridor, task_spec=TASK_SPEC.encode())),
    "a slip in the task spec": (
        Rule.TASK_SPEC,
        broken(Corridor, task_spec=TASK_SPEC.replace("(0 9)", "(9 0)")),
    ),
    "a list for an observation": (Rule.OBSERVATION, broken(Corridor, observe=lambda self: [self.field])),
    "an action for one": (Rule.OBSERVATION, broken(Corridor, observe=lambda self: Action([0], [0.5]))),
    "steps out of its space": (
        Rule.OBSERVATION_SPACE,
        broken(Corridor, env_step=lambda self, action: (0.0, Observation([10], [0.5]), True)),
    ),
    "starts out of its space": (
        Rule.OBSERVATION_SPACE,
        broken(Corridor, env_start=lambda self: (Corridor.env_start(self), Observation([0]))[1]),
    ),
    "five answers": (Rule.STEP, broken(Corridor, env_step=stepping(lambda *step: (*step, False, {})))),
    "one answer": (Rule.STEP, broken(Corridor, env_step=stepping(lambda *step: step[1]))),
    "no reward": (Rule.REWARD, broken(Corridor, env_step=stepping(lambda *step: (None, *step[1:])))),
    "a reward of NaN": (
        Rule.REWARD,
        broken(Corridor, env_step=stepping(lambda *step: (math.nan, *step[1:]))),
    ),
    "generous": (Rule.REWARD_RANGE, broken(Corridor, env_step=stepping(lambda *step: (0.5, *step[1:])))),
    "an unclear end": (Rule.TERMINAL, broken(Corridor, env_step=stepping(lambda *step: (*step[:2], "no")))),
    "unseeded": (Rule.SEED, Unseeded),
    "draws without a seed": (Rule.REPEATABLE, broken(Unseeded, env_seed=None)),
    "remembers": (Rule.AFRESH, Remembers),
    "saves a text": (Rule.SAVE, broken(Corridor, env_save=lambda self: "saved")),
    "saves nothing": (
        Rule.SAVE,
        broken(Corridor, env_save=lambda self: b"", env_load=lambda self, data: None),
    ),
    "loads anything": (Rule.DAMAGE, broken(Corridor, env_load=load_only_whole)),
    "loads empty bytes": (Rule.DAMAGE, broken(Corridor, env_load=load_unless_empty)),
}


@pytest.mark.parametrize("name", BROKEN_ENVIRONMENTS)
def test_broken_environment_is_found_by_name(name: str) -> None:
    rule, environment = BROKEN_ENVIRONMENTS[name]
    assert caught(lambda: check_environment(environment)).rule is rule


def test_player_without_seed_may_draw_from_the_global_generators_whose_state_stays() -> None:
    def observe(self: Corridor) -> Observation:
        return Observation([self.field or 0], [random.random() * np.random.random()])

    before = random.getstate(), repr(np.random.get_state())
    check_environment(broken(Corridor, observe=observe, env_seed=None, env_save=None, env_load=None))
    assert (random.getstate(), repr(np.random.get_state())) == before


def test_damaged_data_may_be_refused_with_any_exception() -> None:
    def env_load(self: Corridor, data: bytes) -> None:
        self.generator = load_generator(struct.pack("40s", data[:0]) if not data[39] else data)

    def agent_load(self: Wanderer, data: bytes) -> None:
        (self.learned,) = struct.unpack_from("<d", data)
        self.generator = load_generator(data[8:])

    check_environment(broken(Corridor, env_load=env_load))
    check_agent(broken(Wanderer, agent_load=agent_load), TASK_SPEC)


class EndsOnlyAfterAStep(Wanderer):
    steps = 0

    def agent_start(self, observation: Observation) -> Action:
        self.steps = 0
        return super().agent_start(observation)

    def agent_step(self, reward: float, observation: Observation) -> Action:
        self.steps += 1
        return super().agent_step(reward, observation)

    def agent_end(self, reward: float) -> None:
        self.learned += reward / self.steps


class OwnChance(Wanderer):
    def __init__(self) -> None:
        super().__init__()
        self.chance = np.random.default_rng()

    def act(self) -> Action:
        return Action([int(self.chance.integers(2))])


class SavesNoValues(Wanderer):
    def agent_save(self) -> bytes:
        return save_generator(self.generator)

    def agent_load(self, data: bytes) -> None:
        self.generator = load_generator(data)


class SavesNoChance(Wanderer):
    def agent_save(self) -> bytes:
        return struct.pack("<d", self.learned)

    def agent_load(self, data: bytes) -> None:
        if len(data) != 8:
            raise LocalProtocolError("not of 8 bytes")
        (self.learned,) = struct.unpack("<d", data)


def load_padded(self: Wanderer, data: bytes) -> None:
    Wanderer.agent_load(self, data.ljust(len(self.agent_save()), b"\0"))


BROKEN_AGENTS: dict[str, tuple[Rule, type[Wanderer]]] = {
    "cannot step": (Rule.METHODS, broken(Wanderer, agent_step=None)),
    "answers only when ready": (
        Rule.CALLS,
        broken(Wanderer, agent_message=raising(lambda self: not self.ready, "agent_message", Wanderer)),
    ),
    "cleans up only after init": (
        Rule.CALLS,
        broken(Wanderer, agent_cleanup=raising(lambda self: not self.ready, "agent_cleanup", Wanderer)),
    ),
    "inits only after cleanup": (
        Rule.CALLS,
        broken(Wanderer, agent_init=raising(lambda self: self.ready, "agent_init", Wanderer)),
    ),
    "wants to see the end": (
        Rule.CALLS,
        broken(Wanderer, agent_start=raising(lambda self: self.acting, "agent_start", Wanderer)),
    ),
    "ends only after a step": (Rule.CALLS, EndsOnlyAfterAStep),
    "an int for an action": (Rule.ACTION, broken(Wanderer, act=lambda self: 1)),
    "an observation for one": (Rule.ACTION, broken(Wanderer, act=lambda self: Observation([1]))),
    "acts out of its space": (
        Rule.ACTION_SPACE,
        broken(Wanderer, act=lambda self: Action([int(self.generator.integers(3))])),
    ),
    "acts with doubles": (Rule.ACTION_SPACE, broken(Wanderer, act=lambda self: Action(doubles=[0.5]))),
    "bytes for a message": (
        Rule.MESSAGE,
        broken(Wanderer, agent_message=lambda self, message: message.encode()),
    ),
    "its own chance": (Rule.SEED, OwnChance),
    "never forgets": (
        Rule.AFRESH,
        broken(Wanderer, agent_init=lambda self, task_spec: setattr(self, "ready", True)),
    ),
    "saves no values": (Rule.SAVE, SavesNoValues),
    "saves no chance": (Rule.SAVE, SavesNoChance),
    "saves an array": (Rule.SAVE, broken(Wanderer, agent_save=lambda self: np.array([self.learned]))),
    "loads cut values": (Rule.DAMAGE, broken(Wanderer, agent_load=load_padded)),
}


@pytest.mark.parametrize("name", BROKEN_AGENTS)
def test_broken_agent_is_found_by_name(name: str) -> None:
    rule, agent = BROKEN_AGENTS[name]
    assert caught(lambda: check_agent(agent, TASK_SPEC)).rule is rule


def test_every_rule_is_broken_by_somebody() -> None:
    assert {rule for rule, _ in (*BROKEN_ENVIRONMENTS.values(), *BROKEN_AGENTS.values())} == set(Rule)
