"""Contract checks: glue/testing.py. Each rule is broken by a player made for it, and found by name."""

from __future__ import annotations

import math
import random
import struct
import subprocess
import sys
from collections.abc import Callable
from typing import Any

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


def caught(check: Callable[[], None]) -> ContractBroken:
    with pytest.raises(ContractBroken) as error:
        check()
    return error.value


# Players that keep the rules


def test_good_players_keep_every_rule() -> None:
    check_environment(Corridor)
    check_agent(Wanderer, TASK_SPEC)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("episodes", "steps"), [(1, 1), (5, 20)])
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
    class Private(Corridor):
        pass

    Private.task_spec = task_spec
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
    class Numpy(Corridor):
        def env_step(self, action: Action) -> Any:
            reward, observation, terminal, *_ = super().env_step(action)
            return np.float64(reward), observation, np.bool_(terminal)

    check_environment(Numpy)


def test_error_names_rule_call_and_answer() -> None:
    class Shy(Corridor):
        def env_message(self, message: str) -> Any:
            return None

    error = caught(lambda: check_environment(Shy))
    assert error.rule is Rule.MESSAGE
    assert str(error) == "a message is answered with a text: env_message returned None, of type NoneType"
    assert isinstance(error, GlueError)
    assert isinstance(error, AssertionError)


def test_no_test_framework_is_needed() -> None:
    program = "import sys, glue.testing; sys.exit('pytest' in sys.modules or '_pytest' in sys.modules)"
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60)


# Environments that break one rule


class NoStart(Corridor):
    env_start = None  # type: ignore[assignment]


class SpeaksOnlyWhenReady(Corridor):
    def env_message(self, message: str) -> str:
        if not self.ready:
            raise SimulatorError("not ready")
        return ""


class SpeaksOnlyInEpisodes(Corridor):
    def env_message(self, message: str) -> str:
        return f"at {self.observe()}"


class CleansUpOnlyWhatInitTook(Corridor):
    def env_init(self) -> str:
        self.taken = "a window"
        return super().env_init()

    def env_cleanup(self) -> None:
        assert self.taken


class CleansUpOnce(Corridor):
    taken: str | None = "a window"

    def env_init(self) -> str:
        self.taken = "a window"
        return super().env_init()

    def env_cleanup(self) -> None:
        assert self.taken
        self.taken = None


class InitsOnce(Corridor):
    def env_init(self) -> str:
        if self.ready:
            raise SimulatorError("already there")
        return super().env_init()


class NeverInitsAgain(Corridor):
    def env_cleanup(self) -> None:
        if self.ready:
            self.generator = None  # type: ignore[assignment]

    def env_seed(self, seed: int) -> None:
        self.generator.integers(1)


class StartsOnlyAfterTheEnd(Corridor):
    def env_start(self) -> Observation:
        if self.field not in (None, 9):
            raise SimulatorError("the episode is not over")
        return super().env_start()


class TooLargeForInt32(Corridor):
    def env_step(self, action: Action) -> tuple[float, Observation, bool]:
        return 0.0, Observation([2**31]), False


class BytesForTaskSpec(Corridor):
    task_spec = TASK_SPEC.encode()  # type: ignore[assignment]


class SlipInTaskSpec(Corridor):
    task_spec = TASK_SPEC.replace("(0 9)", "(9 0)")


class ListForObservation(Corridor):
    def observe(self) -> Any:
        return [self.field]


class ActionForObservation(Corridor):
    def observe(self) -> Any:
        return Action([0], [0.5])


class StepsOutOfItsSpace(Corridor):
    def env_step(self, action: Action) -> tuple[float, Observation, bool]:
        return 0.0, Observation([10], [0.5]), True


class StartsOutOfItsSpace(Corridor):
    def env_start(self) -> Observation:
        super().env_start()
        return Observation([0])


class FiveAnswers(Corridor):
    def env_step(self, action: Action) -> Any:
        return *super().env_step(action), False, {}


class OneAnswer(Corridor):
    def env_step(self, action: Action) -> Any:
        super().env_step(action)
        return self.observe()


class Unrewarding(Corridor):
    def env_step(self, action: Action) -> Any:
        return None, *super().env_step(action)[1:]


class NanReward(Corridor):
    def env_step(self, action: Action) -> Any:
        return math.nan, *super().env_step(action)[1:]


class Generous(Corridor):
    def env_step(self, action: Action) -> Any:
        return 0.5, *super().env_step(action)[1:]


class UnclearEnd(Corridor):
    def env_step(self, action: Action) -> Any:
        return *super().env_step(action)[:2], "no"


class Unseeded(Corridor):
    def __init__(self) -> None:
        super().__init__()
        self.noise = np.random.default_rng()

    def observe(self) -> Observation:
        return Observation(super().observe().ints, [self.noise.random()])


class DrawsWithoutSeed(Unseeded):
    env_seed = None  # type: ignore[assignment]


class DrawsFromGlobals(DrawsWithoutSeed):
    env_save = env_load = None  # type: ignore[assignment]

    def observe(self) -> Observation:
        assert self.field is not None
        return Observation([self.field], [random.random() * np.random.random()])


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


class SavesText(Corridor):
    def env_save(self) -> Any:
        return "saved"


class SavesNothing(Corridor):
    def env_save(self) -> bytes:
        return b""

    def env_load(self, data: bytes) -> None:
        pass


class LoadsAnything(Corridor):
    def env_load(self, data: bytes) -> None:
        if len(data) == len(self.env_save()):
            super().env_load(data)


class LoadsEmptyBytes(Corridor):
    def env_load(self, data: bytes) -> None:
        if data:
            super().env_load(data)


class LoadsWithATraceback(Corridor):
    def env_load(self, data: bytes) -> None:
        self.generator = load_generator(struct.pack("40s", data[:0]) if not data[39] else data)


BROKEN_ENVIRONMENTS: list[tuple[type[Corridor], Rule]] = [
    (NoStart, Rule.METHODS),
    (SpeaksOnlyWhenReady, Rule.CALLS),
    (SpeaksOnlyInEpisodes, Rule.CALLS),
    (CleansUpOnlyWhatInitTook, Rule.CALLS),
    (CleansUpOnce, Rule.CALLS),
    (InitsOnce, Rule.CALLS),
    (NeverInitsAgain, Rule.CALLS),
    (StartsOnlyAfterTheEnd, Rule.CALLS),
    (TooLargeForInt32, Rule.CALLS),
    (BytesForTaskSpec, Rule.TASK_SPEC),
    (SlipInTaskSpec, Rule.TASK_SPEC),
    (ListForObservation, Rule.OBSERVATION),
    (ActionForObservation, Rule.OBSERVATION),
    (StepsOutOfItsSpace, Rule.OBSERVATION_SPACE),
    (StartsOutOfItsSpace, Rule.OBSERVATION_SPACE),
    (FiveAnswers, Rule.STEP),
    (OneAnswer, Rule.STEP),
    (Unrewarding, Rule.REWARD),
    (NanReward, Rule.REWARD),
    (Generous, Rule.REWARD_RANGE),
    (UnclearEnd, Rule.TERMINAL),
    (Unseeded, Rule.SEED),
    (DrawsWithoutSeed, Rule.REPEATABLE),
    (Remembers, Rule.AFRESH),
    (SavesText, Rule.SAVE),
    (SavesNothing, Rule.SAVE),
    (LoadsAnything, Rule.DAMAGE),
    (LoadsEmptyBytes, Rule.DAMAGE),
]


def test_player_without_seed_may_draw_from_the_global_generators_whose_state_stays() -> None:
    before = random.getstate(), repr(np.random.get_state())
    check_environment(DrawsFromGlobals)
    assert (random.getstate(), repr(np.random.get_state())) == before


def test_damaged_data_may_be_refused_with_any_exception() -> None:
    check_environment(LoadsWithATraceback)
    check_agent(LoadsWithAStructError, TASK_SPEC)


@pytest.mark.parametrize(("environment", "rule"), BROKEN_ENVIRONMENTS)
def test_broken_environment_is_found_by_name(environment: type[Corridor], rule: Rule) -> None:
    assert caught(lambda: check_environment(environment)).rule is rule


# Agents that break one rule


class NoStep(Wanderer):
    agent_step = None  # type: ignore[assignment]


class AnswersOnlyWhenReady(Wanderer):
    def agent_message(self, message: str) -> str:
        if not self.ready:
            raise LocalProtocolError("not ready")
        return ""


class CleansUpOnlyAfterInit(Wanderer):
    def agent_cleanup(self) -> None:
        if not self.ready:
            raise LocalProtocolError("nothing to clean up")
        super().agent_cleanup()


class InitsOnlyAfterCleanup(Wanderer):
    def agent_init(self, task_spec: str) -> None:
        if self.ready:
            raise LocalProtocolError("already there")
        super().agent_init(task_spec)


class WantsToSeeTheEnd(Wanderer):
    def agent_start(self, observation: Observation) -> Action:
        if self.acting:
            raise LocalProtocolError("the episode is not over")
        return super().agent_start(observation)


class EndsOnlyAfterAStep(Wanderer):
    def agent_start(self, observation: Observation) -> Action:
        self.steps = 0
        return super().agent_start(observation)

    def agent_step(self, reward: float, observation: Observation) -> Action:
        self.steps += 1
        return super().agent_step(reward, observation)

    def agent_end(self, reward: float) -> None:
        self.learned += reward / self.steps


class IntForAction(Wanderer):
    def act(self) -> Any:
        return 1


class ObservationForAction(Wanderer):
    def act(self) -> Any:
        return Observation([1])


class ActsOutOfItsSpace(Wanderer):
    def act(self) -> Action:
        return Action([int(self.generator.integers(3))])


class ActsWithDoubles(Wanderer):
    def act(self) -> Action:
        return Action(doubles=[0.5])


class BytesForMessage(Wanderer):
    def agent_message(self, message: str) -> Any:
        return message.encode()


class OwnChance(Wanderer):
    def __init__(self) -> None:
        super().__init__()
        self.chance = np.random.default_rng()

    def act(self) -> Action:
        return Action([int(self.chance.integers(2))])


class NeverForgets(Wanderer):
    def agent_init(self, task_spec: str) -> None:
        self.ready = True


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


class SavesAnArray(Wanderer):
    def agent_save(self) -> Any:
        return np.array([self.learned])


class LoadsCutValues(Wanderer):
    def agent_load(self, data: bytes) -> None:
        super().agent_load(data.ljust(len(self.agent_save()), b"\0"))


class LoadsWithAStructError(Wanderer):
    def agent_load(self, data: bytes) -> None:
        (self.learned,) = struct.unpack_from("<d", data)
        self.generator = load_generator(data[8:])


BROKEN_AGENTS: list[tuple[type[Wanderer], Rule]] = [
    (NoStep, Rule.METHODS),
    (AnswersOnlyWhenReady, Rule.CALLS),
    (CleansUpOnlyAfterInit, Rule.CALLS),
    (InitsOnlyAfterCleanup, Rule.CALLS),
    (WantsToSeeTheEnd, Rule.CALLS),
    (EndsOnlyAfterAStep, Rule.CALLS),
    (IntForAction, Rule.ACTION),
    (ObservationForAction, Rule.ACTION),
    (ActsOutOfItsSpace, Rule.ACTION_SPACE),
    (ActsWithDoubles, Rule.ACTION_SPACE),
    (BytesForMessage, Rule.MESSAGE),
    (OwnChance, Rule.SEED),
    (NeverForgets, Rule.AFRESH),
    (SavesNoValues, Rule.SAVE),
    (SavesNoChance, Rule.SAVE),
    (SavesAnArray, Rule.SAVE),
    (LoadsCutValues, Rule.DAMAGE),
]


@pytest.mark.parametrize(("agent", "rule"), BROKEN_AGENTS)
def test_broken_agent_is_found_by_name(agent: type[Wanderer], rule: Rule) -> None:
    assert caught(lambda: check_agent(agent, TASK_SPEC)).rule is rule


def test_every_rule_is_broken_by_somebody() -> None:
    assert {rule for _, rule in (*BROKEN_ENVIRONMENTS, *BROKEN_AGENTS)} == set(Rule)
