"""The mirror does what docs/clients.md says; the page's examples are run here."""

from __future__ import annotations

from glue.conform.clients.mirror import MirrorAgent
from glue.types import Action, Observation


def test_the_action_of_the_page() -> None:
    agent = MirrorAgent()
    agent.agent_init("")
    agent.agent_start(Observation([1]))
    action = agent.agent_step(-1.0, Observation([3, -5], [0.5], b"ab"))
    assert action == Action([-5, 3, 2], [0.5, -2.0, -1.0], b"ba")
    assert agent.agent_step(1.0, Observation()) == Action()
    assert agent.agent_save() == b"3 0"
