"""The same agent in one process and over sockets."""

from __future__ import annotations

import threading
from collections.abc import Callable

from glue.client.experiment import connect
from glue.client.players import serve_agent, serve_environment
from glue.core.config import HubConfig
from glue.core.experiment import Experiment
from glue.core.local import local
from glue.hub.server import Hub
from glue.roles import Agent, Environment


def check_same_over_sockets(agent: Callable[[], Agent], environment: Callable[[], Environment]) -> None:
    """Play twenty episodes in each topology, with players made anew; the outcomes must be equal."""
    with local(agent(), environment()) as glue:
        expected = _outcomes(glue)
    with Hub(HubConfig(bind=("tcp://127.0.0.1:*",))).in_background() as hub:
        url = hub.endpoints[0]
        players = [
            threading.Thread(target=serve, args=(player, url), kwargs={"log": lambda line: None})
            for serve, player in ((serve_agent, agent()), (serve_environment, environment()))
        ]
        for thread in players:
            thread.start()
        with connect(url, log=lambda line: None) as remote:
            assert _outcomes(remote) == expected
    for thread in players:
        thread.join()


def _outcomes(glue: Experiment) -> list[tuple[float, int]]:
    glue.rl_init(seed=11)
    episodes = []
    for _ in range(20):
        glue.rl_episode(max_steps=0)
        episodes.append((glue.rl_return(), glue.rl_num_steps()))
    return episodes
