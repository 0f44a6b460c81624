"""Agents of every client library play the same episodes as ours, also over connections that are cut.

Cuts, restarts and repetitions at every point are judged by the kit, for each role: see `test_libraries`.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from typing import Final

import pytest

from env_server.mario.environment import InfiniteMario
from glue import connect
from glue.engine.local import local
from tests.clients.languages import LANGUAGES, Language
from tests.clients.random_agent import RandomAgent
from tests.clients.table import Episode, hub, play, program, serving
from tests.system.proxy import Proxy

EPISODES: Final = 100
CUTS: Final = 200

Expected = Callable[[int], Episode]


@pytest.fixture(params=LANGUAGES, ids=lambda language: language.name)
def language(request: pytest.FixtureRequest) -> Language:
    asked: Language = request.param
    asked.ready()
    return asked


@pytest.fixture
def in_mario() -> Expected:
    """A function from a seed to its episode, played by our players in one process."""
    glue = local(RandomAgent(), InfiniteMario())
    return lambda seed: play(glue, seed)


@pytest.fixture(params=["tcp", "ipc"])
def bind(request: pytest.FixtureRequest) -> Iterator[str]:
    if request.param == "tcp":
        yield "tcp://127.0.0.1:*"
        return
    with tempfile.TemporaryDirectory() as folder:  # a test's own path may be too long for a socket
        yield f"ipc://{folder}/hub"


def test_agent_plays_mario_as_the_one_in_python(language: Language, bind: str, in_mario: Expected) -> None:
    with (
        hub(bind) as url,
        serving(InfiniteMario(), url),
        program(language.programs["random"], url),
        connect(url) as glue,
    ):
        episodes = [play(glue, seed) for seed in range(EPISODES)]

    assert episodes == [in_mario(seed) for seed in range(EPISODES)]


def test_agent_whose_connection_is_cut_in_mid_step(language: Language, in_mario: Expected) -> None:
    with (
        hub() as url,
        Proxy(int(url.rpartition(":")[2]), cuts=CUTS, seed=1).in_background() as proxy,
        serving(InfiniteMario(), url),
        program(language.programs["random"], proxy.url),
        connect(url) as glue,
    ):
        episodes: list[Episode] = []
        while not proxy.finished.is_set():
            episodes.append(play(glue, len(episodes)))

    assert episodes == [in_mario(seed) for seed in range(len(episodes))]
