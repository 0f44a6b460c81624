"""The Soar agents keep the contract of every agent."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
import pytest

from env_server.mario.environment import InfiniteMario
from env_server.toys import MinesEnvironment
from glue.plugins.loading import find, names
from glue.testing import check_agent
from glue.types import Action, Observation
from glue.wire.messages import Role

pytest.importorskip("soar_sml", reason="agents on the Soar kernel need it: pip install 'glue-rl[soar]'")

NAMES = [name for name in names(Role.AGENT) if name.startswith("soar-")]


def game(name: str) -> Any:
    return MinesEnvironment() if name == "soar-mines" else InfiniteMario()


@cache
def seen(name: str) -> list[Observation]:
    """Return the observations of 40 steps to the right."""
    player = game(name)
    player.env_init()
    found = [player.env_start()]
    action = Action([3]) if name == "soar-mines" else Action([1, 0, 0])
    while len(found) < 40:
        _, observation, terminal, *_ = player.env_step(action)
        found.append(player.env_start() if terminal else observation)
    return found


def test_all_are_installed() -> None:
    assert len(NAMES) == 7


@pytest.mark.parametrize("name", NAMES)
def test_agent_keeps_the_contract(name: str) -> None:
    def observe(generator: np.random.Generator) -> Observation:
        return seen(name)[int(generator.integers(len(seen(name))))]

    check_agent(find(Role.AGENT, name), game(name).env_init(), observation=observe, episodes=2, steps=20)
