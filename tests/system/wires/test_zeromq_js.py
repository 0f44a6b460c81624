"""zeromq.js, by which Node programs speak ZeroMQ, plays with the hub: libzmq's DEALER in another language."""

from __future__ import annotations

import shutil
import subprocess
import threading
from pathlib import Path
from typing import Final

import pytest

from env_server.toys import SkeletonEnvironment
from glue.client.experiment import connect
from glue.client.players import serve_environment
from glue.hub.config import HubConfig
from glue.hub.io.server import Hub
from tests.scripted.peer import TIMEOUT

pytestmark = [pytest.mark.proof, pytest.mark.stage("proof")]

AGENT: Final = Path(__file__).parents[2] / "clients/dealer.cjs"
VERSION: Final = "6"
EPISODES: Final = 50


@pytest.fixture(scope="module")
def zeromq_js(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which npm has installed zeromq.js."""
    npm = shutil.which("npm")
    if npm is None or shutil.which("node") is None:
        pytest.skip("there is no node with npm here to install zeromq.js")
    folder = tmp_path_factory.mktemp("zeromq")
    (folder / "package.json").write_text('{"private": true}')
    command = [npm, "install", "--silent", "--no-audit", "--no-fund", f"zeromq@{VERSION}"]
    subprocess.run(command, cwd=folder, check=True, timeout=240)
    return folder


@pytest.mark.parametrize("transport", ["tcp", "ipc"])
def test_a_dealer_of_zeromq_js_plays_with_the_hub(zeromq_js: Path, transport: str, tmp_path: Path) -> None:
    url = "tcp://127.0.0.1:*" if transport == "tcp" else f"ipc://{tmp_path}/hub"
    hub = Hub(HubConfig(bind=(url,), heartbeat=0.2, greeting=60.0))
    (url,) = hub.endpoints
    with hub.in_background():
        environment = threading.Thread(target=serve_environment, args=(SkeletonEnvironment(), url))
        environment.start()
        agent = subprocess.Popen(["node", str(AGENT), url, str(zeromq_js)])
        with connect(url) as glue:
            glue.rl_init()
            steps = 0
            for _ in range(EPISODES):
                assert glue.rl_episode()
                steps += glue.rl_num_steps() - 1
            assert glue.rl_num_episodes() == EPISODES
            assert glue.rl_agent_message("how?") == f"{steps} steps"
    environment.join(TIMEOUT)
    assert agent.wait(TIMEOUT) == 0, "it was told goodbye"
