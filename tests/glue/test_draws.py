"""Batched draws: glue/taskspec/draws.py. Values and generator state are those of single samples."""

from __future__ import annotations

import numpy as np
import pytest

from agents.baselines import RandomAgent
from glue.errors import LocalProtocolError
from glue.taskspec import Space, parse_task_spec
from glue.taskspec.draws import Draws
from glue.types import Action, Observation
from tests.proof import size

SPEC = "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1 OBSERVATIONS ACTIONS {} REWARDS (0 1)"
MARIO = "INTS (-1 1) (2 0 1)"
NOTHING = Observation()


def space_of(text: str) -> Space:
    return parse_task_spec(SPEC.format(text)).actions


@pytest.mark.proof
@pytest.mark.parametrize(
    ("text", "usual", "full"),
    [
        pytest.param(MARIO, 3000, 100_000, id="Mario's, with a draw for its no chars"),
        pytest.param("INTS (0 1610612736)", 1500, 100_000, id="one draw in four is rejected"),
        pytest.param("INTS (0 4) (5 5) (UNSPEC POSINF) (-2147483648 2147483647)", 600, 3000, id="any range"),
        pytest.param("INTS (3 0 6) CHARCOUNT 5", 600, 3000, id="chars of more than one word"),
        pytest.param("CHARCOUNT 3", 600, 3000, id="chars alone"),
        pytest.param("INTS (1200 0 6)", 10, 100, id="more numbers than are drawn at once"),
        pytest.param("INTS (0 6) DOUBLES (2 -1 1)", 600, 3000, id="doubles"),
    ],
)
def test_draws_are_those_of_single_samples(text: str, usual: int, full: int) -> None:
    space = space_of(text)
    one_by_one, ahead = np.random.default_rng(7), np.random.default_rng(7)
    # The generator is compared after every value at first, then at growing distances.
    draws, looked_at = Draws(space, ahead), 1
    for count in range(1, size(usual, full) + 1):
        assert draws.draw() == Action(*space.sample(one_by_one)).body
        if count == looked_at:
            looked_at = max(count + 1, count * 5 // 4)
            assert draws.settle().bit_generator.state == one_by_one.bit_generator.state


def test_nothing_is_drawn_from_a_space_that_is_not_stated() -> None:
    with pytest.raises(LocalProtocolError, match="does not state"):
        Draws(Space(stated=False), np.random.default_rng(0)).draw()


def test_the_random_agent_saves_and_loads_in_mid_stream_and_goes_on_after_another_init() -> None:
    generator = np.random.default_rng(11)
    agent = RandomAgent(seed=11)
    for text in (MARIO, "INTS (0 9)"):
        space = space_of(text)
        agent.agent_init(SPEC.format(text))
        for _ in range(5):
            other = RandomAgent(seed=0)
            other.agent_init(SPEC.format(text))
            other.agent_load(agent.agent_save())
            action = Action(*space.sample(generator))
            assert action == agent.agent_start(NOTHING) == other.agent_start(NOTHING)
