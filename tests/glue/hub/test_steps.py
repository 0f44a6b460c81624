"""Steps take their quick way from end to end: what a step costs is what everybody waits for."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from glue.client import frames
from glue.client.experiment import connect
from glue.client.players import serve_agent, serve_environment
from glue.core.config import HubConfig
from glue.hub import server
from glue.hub.inside import InsideTransport
from glue.hub.server import Hub
from tests.players import ChainAgent, ChainEnvironment

EPISODES = 15
STEPS = 20
"""In each episode of ChainEnvironment."""
SESSIONS = 8


@pytest.mark.parametrize("verb", ["RL_EPISODE", "RL_STEP"])
@pytest.mark.parametrize("transport", ["tcp", "ipc"])
def test_the_steps_of_an_episode_are_never_parsed(
    verb: str, transport: str, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    parsed = []
    for module in (frames, server):
        decode = module.decode

        def count(*arguments: Any, decode: Any = decode, name: str = module.__name__) -> Any:
            message = decode(*arguments)
            parsed.append((name, message.kind.name))
            return message

        monkeypatch.setattr(module, "decode", count)
    url = "tcp://127.0.0.1:*" if transport == "tcp" else f"ipc://{tmp_path}/hub"
    with Hub(HubConfig(bind=(url,))).in_background() as hub:
        players = [
            threading.Thread(target=serve, args=(player, hub.endpoints[0]))
            for serve, player in ((serve_agent, ChainAgent()), (serve_environment, ChainEnvironment()))
        ]
        for player in players:
            player.start()
        with connect("inside", transport=InsideTransport(hub)) as glue:
            glue.rl_init()
            for _ in range(EPISODES):
                if verb == "RL_EPISODE":
                    glue.rl_episode()
                    continue
                glue.rl_start()
                for _ in range(STEPS):
                    glue.rl_step()
            assert glue.rl_num_episodes() == EPISODES
    for player in players:
        player.join()
    steps = [name for name, kind in parsed if kind in ("ENV_STEP", "AGENT_STEP")]
    # A heartbeat may share what a system call receives with one of them.
    assert len(steps) < EPISODES * STEPS / 10, steps


def test_the_steps_of_many_sessions_are_hardly_ever_parsed(monkeypatch: pytest.MonkeyPatch) -> None:
    parsed = []
    for module in (frames, server):
        decode = module.decode

        def count(*arguments: Any, decode: Any = decode) -> Any:
            message = decode(*arguments)
            parsed.append(message.kind.name)
            return message

        monkeypatch.setattr(module, "decode", count)
    sessions = [str(number) for number in range(SESSIONS)]
    with Hub(HubConfig(bind=("tcp://127.0.0.1:*",))).in_background() as hub:
        url = hub.endpoints[0]
        players = [
            threading.Thread(target=serve, args=({name: make() for name in sessions}, url))
            for serve, make in ((serve_agent, ChainAgent), (serve_environment, ChainEnvironment))
        ]
        for player in players:
            player.start()

        def play(session: str) -> None:
            with connect(url, session) as glue:
                glue.rl_init()
                for _ in range(EPISODES):
                    glue.rl_episode()
                assert glue.rl_num_steps() == STEPS

        with ThreadPoolExecutor(SESSIONS) as pool:
            list(pool.map(play, sessions))
    for player in players:
        player.join()
    steps = [kind for kind in parsed if kind in ("ENV_STEP", "AGENT_STEP")]
    # One may arrive in two pieces, or follow something else.
    assert len(steps) < SESSIONS * EPISODES * STEPS / 10
