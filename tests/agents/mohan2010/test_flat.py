"""The flat agents: SARSA computed by hand, and the last reward, lost or learned."""

from __future__ import annotations

import pytest

from agents.mario.agent import ACTIONS
from agents.mohan2010.flat import ObjectsFlatAgent, TilesAgent, TilesCoarseAgent
from tests.agents.screens import TASK_SPEC, draw, key, learned

HERE = ("  M  ", "77777")


def key_of_here(action: int) -> int:
    """Return the key of an action in experiment 1's state of the screen HERE: nothing below the floor."""
    air = [ord(" ")] * 5
    return key(11, *[ord("7")] * 5, *air, *air, action)


def begun(agent: TilesAgent) -> TilesAgent:
    agent.agent_seed(3)
    agent.agent_init(TASK_SPEC)
    return agent


def test_an_episode_by_hand() -> None:
    agent = begun(TilesAgent(epsilon=0.0, terminal_update=True))
    here = draw(*HERE)
    first = ACTIONS.index(agent.agent_start(here))
    second = ACTIONS.index(agent.agent_step(2.0, here))
    assert second != first
    expected = {key_of_here(first): 0.3 * 2.0}
    assert learned(agent) == pytest.approx(expected)
    # The first action is now the best, so the second one bootstraps from its value.
    assert ACTIONS.index(agent.agent_step(-1.0, here)) == first
    expected[key_of_here(second)] = 0.3 * (-1.0 + 0.9 * 0.6)
    assert learned(agent) == pytest.approx(expected)
    agent.agent_end(-10.0)
    expected[key_of_here(first)] = 0.6 + 0.3 * (-10.0 - 0.6)
    assert learned(agent) == pytest.approx(expected)


@pytest.mark.parametrize("kind", [TilesAgent, TilesCoarseAgent, ObjectsFlatAgent])
@pytest.mark.parametrize("terminal_update", [False, True])
def test_the_last_reward_is_lost_unless_told_otherwise(kind: type[TilesAgent], terminal_update: bool) -> None:
    agent = begun(kind(terminal_update=terminal_update))
    agent.agent_start(draw(*HERE))
    agent.agent_end(-10.0)
    assert sum(learned(agent).values()) == pytest.approx(0.3 * -10.0 if terminal_update else 0.0)
    # Nor does it leak into the next episode.
    agent.agent_start(draw(*HERE))
    assert sum(learned(agent).values()) == pytest.approx(0.3 * -10.0 if terminal_update else 0.0)


def test_parts_share_the_update() -> None:
    agent = begun(TilesCoarseAgent())
    agent.agent_start(draw(*HERE))
    agent.agent_step(1.5, draw(*HERE))
    assert list(learned(agent).values()) == pytest.approx([0.3 * 1.5 / 15] * 15)


def test_epsilon_shrinks_by_one_cycle_a_step() -> None:
    agent = begun(TilesAgent(epsilon=0.5, reduction=0.5))
    agent.agent_start(draw(*HERE))
    agent.agent_step(0.0, draw(*HERE))
    agent.agent_end(0.0)
    assert float(agent.agent_message("epsilon")) == 0.5 * 0.25
    agent.agent_start(draw(*HERE))
    assert float(agent.agent_message("epsilon")) == 0.5 * 0.125
