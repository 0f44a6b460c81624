"""The Soar agents keep the contract of every agent."""

from __future__ import annotations

from functools import partial

import pytest

from glue.plugins.loading import find, names
from glue.testing import check_agent
from glue.wire.messages import Role
from tests.contract.test_installed_players import observe

pytest.importorskip("soar_sml", reason="agents on the Soar kernel need it: pip install 'glue-rl[soar]'")

NAMES = [name for name in names(Role.AGENT) if name.startswith("soar-")]


def test_all_are_installed() -> None:
    assert len(NAMES) == 7


@pytest.mark.parametrize("name", NAMES)
def test_agent_keeps_the_contract(name: str) -> None:
    task = "mines" if name == "soar-mines" else "mario"
    task_spec = find(Role.ENVIRONMENT, task)().env_init()
    check_agent(find(Role.AGENT, name), task_spec, observation=partial(observe, task), episodes=2, steps=20)
