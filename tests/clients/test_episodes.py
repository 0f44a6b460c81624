"""Programs of every client library play the same episodes as ours, even if killed or disconnected."""

from __future__ import annotations

import random
import tempfile
from collections.abc import Callable, Iterator
from typing import Final

import pytest

from env_server.mario.environment import InfiniteMario
from env_server.toys import SkeletonEnvironment
from glue import connect
from glue.engine.experiment import Experiment
from glue.engine.local import local
from glue.errors import PeerLost
from tests.clients.languages import LANGUAGES, Language
from tests.clients.random_agent import RandomAgent
from tests.clients.table import (
    SECONDS,
    Episode,
    hub,
    play,
    program,
    read_episodes,
    serving,
)
from tests.system.proxy import Proxy

EPISODES: Final = 100
CUTS: Final = 200
KILLS: Final = 5

Expected = Callable[[int], Episode]


@pytest.fixture(params=LANGUAGES, ids=lambda language: language.name)
def language(request: pytest.FixtureRequest) -> Language:
    asked: Language = request.param
    asked.ready()
    return asked


def expecting(glue: Experiment) -> Expected:
    """Return a function from a seed to its episode, played by our players in one process."""
    return lambda seed: play(glue, seed)


@pytest.fixture
def in_mario() -> Expected:
    return expecting(local(RandomAgent(), InfiniteMario()))


@pytest.fixture
def in_the_walk() -> Expected:
    return expecting(local(RandomAgent(), SkeletonEnvironment()))


@pytest.fixture(params=["tcp", "ipc"])
def bind(request: pytest.FixtureRequest) -> Iterator[str]:
    if request.param == "tcp":
        yield "tcp://127.0.0.1:*"
        return
    with tempfile.TemporaryDirectory() as folder:  # a test's own path may be too long for a socket
        yield f"ipc://{folder}/hub"


def joined(url: str) -> Experiment:
    return connect(url)


def test_agent_plays_mario_as_the_one_in_python(language: Language, bind: str, in_mario: Expected) -> None:
    with (
        hub(bind) as url,
        serving(InfiniteMario(), url),
        program(language.programs["random"], url),
        joined(url) as glue,
    ):
        episodes = [play(glue, seed) for seed in range(EPISODES)]

    assert episodes == [in_mario(seed) for seed in range(EPISODES)]


def begin(glue: Experiment, seed: int) -> None:
    """Begin an episode as soon as the replacement of a killed player has joined."""
    while True:
        try:
            glue.rl_init(seed)
            glue.rl_start()
            return
        except PeerLost:
            continue


def test_agent_is_killed_in_mid_episode_and_started_again(language: Language, in_mario: Expected) -> None:
    with hub() as url, serving(InfiniteMario(), url), joined(url) as glue:
        for seed in range(KILLS):
            with program(language.programs["random"], url):
                begin(glue, seed)
                for _ in range(20 + seed):
                    glue.rl_step()
            with program(language.programs["random"], url):
                with pytest.raises(PeerLost):
                    glue.rl_step()
                assert play(glue, seed) == in_mario(seed)


def test_environment_is_killed_in_mid_episode_and_started_again(
    language: Language, in_the_walk: Expected
) -> None:
    with hub() as url, serving(RandomAgent(), url), joined(url) as glue:
        for seed in range(KILLS):
            with program(language.programs["skeleton"], url):
                begin(glue, seed)
                for _ in range(5):
                    glue.rl_step()
            with program(language.programs["skeleton"], url):
                with pytest.raises(PeerLost):
                    glue.rl_step()
                assert play(glue, seed) == in_the_walk(seed)


def walked(episodes: int, seed: int) -> list[Episode]:
    """Return the episodes that the example experiment prints, played by our players."""
    glue = local(RandomAgent(), SkeletonEnvironment())
    glue.rl_init(seed)
    result = []
    for _ in range(episodes):
        glue.rl_episode(1000)
        result.append((glue.rl_return(), glue.rl_num_steps()))
    return result


def test_experiment_is_killed_in_mid_run_and_started_again(language: Language) -> None:
    command = [*language.programs["experiment"], "20", "7"]
    with hub() as url, serving(RandomAgent(), url), serving(SkeletonEnvironment(), url):
        for kill in range(KILLS):
            with program(command, url) as doomed:
                assert doomed.stdout is not None
                for _ in range(1 + kill):
                    doomed.stdout.readline()
        with program(command, url) as process:
            assert process.stdout is not None
            episodes = read_episodes(process.stdout)
            assert process.wait(SECONDS) == 0

    assert episodes == walked(20, seed=7)


class Scissors(Proxy):
    """Cuts connections so often that little more than a greeting gets through."""

    def __init__(self, port: int) -> None:
        self._chance = random.Random(1)
        super().__init__(port, cuts=CUTS)

    def _draw(self) -> int:
        return self._chance.randint(1, 1200)


def port(url: str) -> int:
    return int(url.rpartition(":")[2])


def test_agent_whose_connection_is_cut_in_mid_step(language: Language, in_mario: Expected) -> None:
    with (
        hub() as url,
        Proxy(port(url), cuts=CUTS, seed=1).in_background() as proxy,
        serving(InfiniteMario(), url),
        program(language.programs["random"], proxy.url),
        joined(url) as glue,
    ):
        episodes: list[Episode] = []
        while not proxy.finished.is_set():
            episodes.append(play(glue, len(episodes)))

    assert episodes == [in_mario(seed) for seed in range(len(episodes))]


def test_environment_whose_connection_is_cut_in_mid_step(language: Language, in_the_walk: Expected) -> None:
    with (
        hub() as url,
        Scissors(port(url)).in_background() as proxy,
        serving(RandomAgent(), url),
        program(language.programs["skeleton"], proxy.url),
        joined(url) as glue,
    ):
        episodes: list[Episode] = []
        while not proxy.finished.is_set():
            episodes.append(play(glue, len(episodes)))

    assert episodes == [in_the_walk(seed) for seed in range(len(episodes))]


def test_experiment_whose_connection_is_cut_in_mid_request(language: Language) -> None:
    episodes = 3 * CUTS
    command = [*language.programs["experiment"], str(episodes), "7"]
    with (
        hub() as url,
        Scissors(port(url)).in_background() as proxy,
        serving(RandomAgent(), url),
        serving(SkeletonEnvironment(), url),
        program(command, proxy.url) as process,
    ):
        assert process.stdout is not None
        played = read_episodes(process.stdout)
        assert process.wait(SECONDS) == 0
        assert proxy.finished.is_set()

    assert played == walked(episodes, seed=7)
