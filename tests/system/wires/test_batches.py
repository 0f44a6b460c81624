"""Many sessions over one connection, whose steps and answers travel together, and which breaks."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import partial

import pytest

from agents.baselines import RandomAgent
from env_server.toys import SkeletonEnvironment
from glue import Experiment, connect, local
from glue.client.sockets import SocketTransport
from glue.hub.config import HubConfig
from glue.hub.io.server import Hub
from tests.hubs import serving
from tests.proof import size
from tests.system.proxy import Proxy

SESSIONS = 8
EPISODES, CUTS = size((12, 12), (200, 250))


@pytest.fixture
def together(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Number of answers that were sent at once, each time."""
    numbers: list[int] = []
    send = SocketTransport._send_joined

    def counted(transport: SocketTransport) -> bool:
        numbers.append(len(transport._joined))
        return send(transport)

    monkeypatch.setattr(SocketTransport, "_send_joined", counted)
    return numbers


@pytest.mark.proof
def test_answers_sent_together_over_connections_that_break_have_the_same_returns(together: list[int]) -> None:
    hub = Hub(HubConfig(bind=("tcp://127.0.0.1:*",), greeting=60.0))
    agents = {str(i): RandomAgent(seed=i) for i in range(SESSIONS)}
    environments = {str(i): SkeletonEnvironment() for i in range(SESSIONS)}
    with (
        Proxy(hub.endpoints[0], CUTS, seed=5).in_background() as proxy,
        serving(proxy.url, agents, environments),
        hub.in_background(),
        ThreadPoolExecutor(SESSIONS) as pool,
    ):
        came = list(pool.map(partial(over, hub), range(SESSIONS)))
        assert proxy.finished.is_set(), "all cuts were made"

    assert came == [*map(alone, range(SESSIONS))]
    assert max(together) > 1


def over(hub: Hub, number: int) -> list[tuple[float, int]]:
    with connect(hub.endpoints[0], str(number)) as glue:
        return outcomes(glue)


def alone(number: int) -> list[tuple[float, int]]:
    with local(RandomAgent(seed=number), SkeletonEnvironment()) as glue:
        return outcomes(glue)


def outcomes(glue: Experiment) -> list[tuple[float, int]]:
    glue.rl_init()
    came = []
    for _ in range(EPISODES):
        glue.rl_episode(500)
        came.append((glue.rl_return(), glue.rl_num_steps()))
    return came
