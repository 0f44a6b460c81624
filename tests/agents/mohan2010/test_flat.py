"""The flat agents: SARSA computed by hand, and the last reward, lost or learned."""

from __future__ import annotations

from typing import TYPE_CHECKING

import pytest

from agents.mario.agent import ACTIONS
from agents.mohan2010.flat import ObjectsFlatAgent, TilesAgent, TilesCoarseAgent

if TYPE_CHECKING:
    from tests.agents.conftest import Draw, Key, Learned

GROUND = "7" * 21
HERE = ("  M  ", "77777")


def key_of_here(key: Key, action: int) -> int:
    """Return the key of an action in experiment 1's state of the screen HERE: nothing below the floor."""
    air = [ord(" ")] * 5
    return key(11, *[ord("7")] * 5, *air, *air, action)


def begun(agent: TilesAgent, task_spec: str) -> TilesAgent:
    agent.agent_seed(3)
    agent.agent_init(task_spec)
    return agent


def test_an_episode_by_hand(draw: Draw, key: Key, learned: Learned, task_spec: str) -> None:
    agent = begun(TilesAgent(epsilon=0.0, terminal_update=True), task_spec)
    here = draw(*HERE)
    first = ACTIONS.index(agent.agent_start(here))
    second = ACTIONS.index(agent.agent_step(2.0, here))
    assert second != first
    expected = {key_of_here(key, first): 0.3 * 2.0}
    assert learned(agent) == pytest.approx(expected)
    # The first action is now the best, so the second one bootstraps from its value.
    assert ACTIONS.index(agent.agent_step(-1.0, here)) == first
    expected[key_of_here(key, second)] = 0.3 * (-1.0 + 0.9 * 0.6)
    assert learned(agent) == pytest.approx(expected)
    agent.agent_end(-10.0)
    expected[key_of_here(key, first)] = 0.6 + 0.3 * (-10.0 - 0.6)
    assert learned(agent) == pytest.approx(expected)


@pytest.mark.parametrize("kind", [TilesAgent, TilesCoarseAgent, ObjectsFlatAgent])
@pytest.mark.parametrize("terminal_update", [False, True])
def test_the_last_reward_is_lost_unless_told_otherwise(
    draw: Draw, learned: Learned, task_spec: str, kind: type[TilesAgent], terminal_update: bool
) -> None:
    agent = begun(kind(terminal_update=terminal_update), task_spec)
    agent.agent_start(draw(*HERE))
    agent.agent_end(-10.0)
    assert sum(learned(agent).values()) == pytest.approx(0.3 * -10.0 if terminal_update else 0.0)
    # Nor does it leak into the next episode.
    agent.agent_start(draw(*HERE))
    assert sum(learned(agent).values()) == pytest.approx(0.3 * -10.0 if terminal_update else 0.0)


def test_parts_share_the_update(draw: Draw, learned: Learned, task_spec: str) -> None:
    agent = begun(TilesCoarseAgent(), task_spec)
    agent.agent_start(draw(*HERE))
    agent.agent_step(1.5, draw(*HERE))
    assert list(learned(agent).values()) == pytest.approx([0.3 * 1.5 / 15] * 15)


def test_epsilon_shrinks_by_one_cycle_a_step(draw: Draw, task_spec: str) -> None:
    agent = begun(TilesAgent(epsilon=0.5, reduction=0.5), task_spec)
    agent.agent_start(draw(*HERE))
    agent.agent_step(0.0, draw(*HERE))
    agent.agent_end(0.0)
    assert float(agent.agent_message("epsilon")) == 0.5 * 0.25
    agent.agent_start(draw(*HERE))
    assert float(agent.agent_message("epsilon")) == 0.5 * 0.125
