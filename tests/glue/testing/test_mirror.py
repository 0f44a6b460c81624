"""The mirror does what docs/clients.md says; the page's examples are run here."""

from __future__ import annotations

import struct

from glue.conform.clients.mirror import MirrorAgent, MirrorEnvironment
from glue.types import Action, Observation


def test_the_action_of_the_page() -> None:
    agent = MirrorAgent()
    agent.agent_init("")
    agent.agent_start(Observation([1]))
    action = agent.agent_step(-1.0, Observation([3, -5], [0.5], b"ab"))
    assert action == Action([-5, 3, 2], [0.5, -2.0, -1.0], b"ba")
    assert agent.agent_step(1.0, Observation()) == Action()
    assert agent.agent_save() == b"3 0"


def test_the_environment_rewards_and_ends_as_its_action_says() -> None:
    environment = MirrorEnvironment()
    environment.env_init()
    assert environment.env_start() == Observation([1])
    assert environment.env_step(Action([7], [-0.0, 2.0], b"a!"))[:3] == (
        0.0,
        Observation([7, 2], [2.0, -0.0, 7.0], b"!a"),
        True,
    )
    reward = environment.env_step(Action(doubles=[-0.0]))[0]
    assert struct.pack("<d", reward) == struct.pack("<d", -0.0)
    assert environment.env_step(Action())[:3] == (0.0, Observation(), False)
