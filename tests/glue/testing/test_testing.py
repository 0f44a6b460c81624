"""Contract checks: glue/testing.py. Each rule is broken by a player made for it, and found by name."""

from __future__ import annotations

import random
import struct
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pytest

from glue.errors import GlueError, LocalProtocolError
from glue.saves import load_generator
from glue.testing import ContractBroken, Rule, check_agent, check_environment
from glue.types import Action, Observation
from tests.changes import changed, read_table
from tests.glue.testing.players import TASK_SPEC, Corridor, Wanderer

PLAYERS = Path(__file__).with_name("players.py")
BROKEN = read_table(Path(__file__).with_name("broken.toml"))
"""Players that break one rule of the contract each, as changes of good ones."""

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


class PlainWanderer(Wanderer):
    """Offers nothing beyond the role, and begins differently with each state of the global generator."""

    agent_seed = agent_save = agent_load = None  # type: ignore[assignment]

    def agent_init(self, task_spec: str) -> None:
        self.generator = np.random.default_rng(random.getrandbits(32))
        super().agent_init(task_spec)


def test_capabilities_need_not_be_offered() -> None:
    check_environment(broken(Corridor, env_seed=None, env_save=None, env_load=None))
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


@pytest.mark.parametrize("mistake", BROKEN)
def test_a_broken_player_is_found_by_the_name_of_its_rule(mistake: str) -> None:
    broken = changed(PLAYERS, BROKEN[mistake])
    agent = BROKEN[mistake]["role"] == "agent"
    error = caught(
        lambda: check_agent(broken.Wanderer, TASK_SPEC) if agent else check_environment(broken.Corridor)
    )
    assert error.rule.name == BROKEN[mistake]["rule"]


def test_every_rule_is_broken_by_somebody() -> None:
    assert {row["rule"] for row in BROKEN.values()} == set(Rule.__members__)
