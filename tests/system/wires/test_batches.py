"""Many sessions over one connection, whose steps and answers travel together: cut, and in single bytes."""

from __future__ import annotations

import threading
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from typing import Any

import pytest

from agents.baselines import RandomAgent
from env_server.toys import SkeletonEnvironment
from glue import connect, local, serve_agent, serve_environment
from glue.client.link import Link
from glue.core.config import HubConfig
from glue.core.experiment import Experiment
from glue.hub.server import Hub
from tests.proof import size
from tests.system.proxy import Proxy

SESSIONS = 8
EPISODES, CUTS = size((12, 12), (200, 250))


@pytest.fixture
def together(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many answers were sent at once, each time."""
    numbers: list[int] = []
    send = Link.send_steps

    def counted(link: Link, answers: Sequence[Any]) -> None:
        numbers.append(len(answers))
        send(link, answers)

    monkeypatch.setattr(Link, "send_steps", counted)
    return numbers


@pytest.mark.proof
@pytest.mark.parametrize(
    ("cuts", "piece", "episodes"),
    [(CUTS, 4096, EPISODES), (0, 1, size(1, 10))],
    ids=["cut", "in single bytes"],
)
def test_answers_sent_together_have_the_same_returns(
    together: list[int], cuts: int, piece: int, episodes: int
) -> None:
    with ExitStack() as stack:
        hub = stack.enter_context(Hub(HubConfig(bind=("tcp://127.0.0.1:*",))).in_background())
        port = int(hub.endpoints[0].rpartition(":")[2])
        proxy = stack.enter_context(Proxy(port, cuts, seed=5, piece=piece).in_background())
        served = [
            threading.Thread(target=serve, args=(players, proxy.url), kwargs={"log": lambda line: None})
            for serve, players in (
                (serve_agent, {str(i): RandomAgent(seed=i) for i in range(SESSIONS)}),
                (serve_environment, {str(i): SkeletonEnvironment() for i in range(SESSIONS)}),
            )
        ]
        for thread in served:
            thread.start()
        with ThreadPoolExecutor(SESSIONS) as pool:
            came = list(pool.map(lambda i: over(hub, i, episodes), range(SESSIONS)))
        assert proxy.finished.is_set() == bool(cuts), "all cuts were made"
        hub.stop("the test is over")
        for thread in served:
            thread.join()

    assert came == [alone(i, episodes) for i in range(SESSIONS)]
    assert max(together) > 1


def over(hub: Hub, number: int, episodes: int) -> list[tuple[float, int]]:
    with connect(hub.endpoints[0], str(number), log=lambda line: None) as glue:
        return outcomes(glue, episodes)


def alone(number: int, episodes: int) -> list[tuple[float, int]]:
    with local(RandomAgent(seed=number), SkeletonEnvironment()) as glue:
        return outcomes(glue, episodes)


def outcomes(glue: Experiment, episodes: int) -> list[tuple[float, int]]:
    glue.rl_init()
    came = []
    for _ in range(episodes):
        glue.rl_episode(500)
        came.append((glue.rl_return(), glue.rl_num_steps()))
    return came
