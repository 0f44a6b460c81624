"""Every agent of the paper learns; what else it must keep, tests/contract tests."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from agents.mohan2010.flat import TilesAgent
from env_server.mario.environment import InfiniteMario
from glue.engine.local import local
from glue.plugins.loading import find
from glue.wire.messages import Role
from tests.players import returns

PAPER = (
    *("tiles", "tiles-coarse", "objects-flat", "hierarchical-programmed", "hierarchical"),
    *("hierarchical-facts", "hierarchical-internal", "objects-coarse"),
)
"""Its agents, in the order of its experiments, from 1 to 8."""


@pytest.mark.parametrize("name", PAPER)
def test_every_learner_improves_on_a_short_level(name: str) -> None:
    """The mean return of the last 60 episodes exceeds that of the first by more than 10.

    The flat agents follow the textbook here; as published, they lose the reward for dying.
    """
    kind: Any = find(Role.AGENT, name)
    agent = kind(seed=1, terminal_update=True) if issubclass(kind, TilesAgent) else kind(seed=1)
    # A few Goombas and coins.
    with local(agent, InfiniteMario(level_seed=7, level_width=60, max_trial_steps=150)) as glue:
        glue.rl_init()
        found = returns(glue, 400)
    assert np.mean(found[-60:]) - np.mean(found[:60]) > 10.0
