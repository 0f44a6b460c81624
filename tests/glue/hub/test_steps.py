"""Steps are recognised by their bytes from end to end, since every run waits for them."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from glue.client.experiment import connect
from glue.wire import codec, stream
from tests.hubs import hub_with
from tests.players import ChainAgent, ChainEnvironment

EPISODES = 15
STEPS = 20
"""Number of steps in each episode of ChainEnvironment."""


@pytest.mark.parametrize("verb", ["RL_EPISODE", "RL_STEP"])
@pytest.mark.parametrize("transport", ["tcp", "ipc"])
@pytest.mark.parametrize("sessions", [1, 8])
def test_steps_are_hardly_ever_decoded_in_full(
    verb: str, transport: str, sessions: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    decoded = []
    decode = codec.decode

    def count(*arguments: Any) -> Any:
        message = decode(*arguments)
        decoded.append(message.kind.name)
        return message

    monkeypatch.setattr(stream, "decode", count)
    url = "tcp://127.0.0.1:*" if transport == "tcp" else f"ipc://{tmp_path}/hub"
    names = [str(number) for number in range(sessions)]
    agents = {name: ChainAgent() for name in names}
    environments = {name: ChainEnvironment() for name in names}
    with hub_with(agents, environments, bind=url) as url:

        def play(session: str) -> None:
            with connect(url, session) as glue:
                glue.rl_init()
                for _ in range(EPISODES):
                    if verb == "RL_EPISODE":
                        glue.rl_episode()
                        continue
                    glue.rl_start()
                    for _ in range(STEPS):
                        glue.rl_step()
                assert glue.rl_num_episodes() == EPISODES

        with ThreadPoolExecutor(sessions) as pool:
            list(pool.map(play, names))
    steps = [kind for kind in decoded if kind in ("ENV_STEP", "AGENT_STEP")]
    # A step may arrive in two pieces, or behind another message.
    assert len(steps) < sessions * EPISODES * STEPS / 10
