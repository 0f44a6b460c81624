"""The same agent in one process and over sockets."""

from __future__ import annotations

from collections.abc import Callable

from glue.engine.experiment import Experiment
from glue.engine.local import local
from glue.roles import Agent, Environment
from tests.hubs import over_the_hub


def check_same_over_sockets(agent: Callable[[], Agent], environment: Callable[[], Environment]) -> None:
    """Play twenty episodes in each topology, with new players; the outcomes must be equal."""
    with local(agent(), environment()) as glue:
        expected = _outcomes(glue)
    with over_the_hub(agent(), environment()) as remote:
        assert _outcomes(remote) == expected


def _outcomes(glue: Experiment) -> list[tuple[float, int]]:
    glue.rl_init(seed=11)
    episodes = []
    for _ in range(20):
        glue.rl_episode(max_steps=0)
        episodes.append((glue.rl_return(), glue.rl_num_steps()))
    return episodes
