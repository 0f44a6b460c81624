"""Cables pulled between hosts, which are network namespaces: packets vanish, and no error is reported."""

from __future__ import annotations

import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager

import pytest

from glue import Action, Observation, PeerLost, local, serve_environment
from glue.client.experiment import RemoteExperiment, connect_over
from glue.hub.config import HubConfig
from glue.hub.io.inside import InsideTransport
from glue.hub.io.server import Hub
from tests.players import At, ChainAgent, ChainEnvironment
from tests.scripted.peer import TIMEOUT
from tests.scripted.process import ROOT
from tests.system.test_faults import chain
from tests.system.wires import networks
from tests.system.wires.networks import NEAR, Networks

pytestmark = [pytest.mark.proof, pytest.mark.stage("proof")]

HEARTBEAT = 0.2
EPISODES = 20


@pytest.fixture
def hosts() -> Iterator[Networks]:
    """Two hosts and a router."""
    why = networks.missing()
    if why is not None:
        pytest.skip(why)
    with Networks() as hosts:
        yield hosts


class Watched(ChainEnvironment):
    """An environment that does something before its fiftieth step."""

    def __init__(self, act: Callable[[], None]) -> None:
        super().__init__()
        self._before = At("env_step", 50, act)

    def env_step(self, action: Action) -> tuple[float, Observation, bool]:
        self._before("env_step")
        return super().env_step(action)


@contextmanager
def run(
    hosts: Networks, environment: ChainEnvironment, timeout: float, libzmq: bool
) -> Iterator[RemoteExperiment]:
    """A hub and an environment on the near host, and an agent on the far one."""
    with hosts.near():
        hub = Hub(
            HubConfig(
                bind=(f"tcp://{NEAR}:*",), heartbeat=HEARTBEAT, timeout=timeout, greeting=60.0, insecure=True
            )
        )
        near = hub.endpoints[0]
    local_hub = InsideTransport(hub)
    with hub.in_background(), ExitStack() as ending:
        thread = threading.Thread(target=serve, args=(hosts, environment, near))
        thread.start()
        ending.callback(thread.join, TIMEOUT)
        ending.callback(hub.stop, "over")
        agent = ["ip", "netns", "exec", hosts.far, sys.executable, "-m", "tests.scripted.process"]
        agent += ["agent", near, "tests.players:ChainAgent", *["libzmq"] * libzmq]
        process = subprocess.Popen(agent, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        ending.callback(process.wait)
        ending.callback(process.kill)
        yield ending.enter_context(connect_over(local_hub))


def serve(hosts: Networks, environment: ChainEnvironment, hub: str) -> None:
    """Serve an environment on the near host."""
    with hosts.near():
        serve_environment(environment, hub)


@pytest.mark.parametrize("libzmq", [False, True], ids=["plain", "libzmq"])
def test_a_blackhole_that_ends_in_time_costs_nothing(hosts: Networks, libzmq: bool) -> None:
    def pull() -> None:
        hosts.swallow(True)
        threading.Timer(1.0, hosts.swallow, (False,)).start()

    with run(hosts, Watched(pull), timeout=30.0, libzmq=libzmq) as glue:
        assert chain(glue, EPISODES) == chain(local(ChainAgent(), ChainEnvironment()), EPISODES)


@pytest.mark.parametrize("libzmq", [False, True], ids=["plain", "libzmq"])
def test_a_player_in_a_blackhole_is_given_up_and_comes_back(hosts: Networks, libzmq: bool) -> None:
    timeout = 1.5
    with run(hosts, Watched(lambda: hosts.swallow(True)), timeout, libzmq) as glue:
        with pytest.raises(PeerLost, match="ChainAgent was unreachable"):
            chain(glue, EPISODES)
        done = glue.rl_num_episodes()
        hosts.swallow(False)
        for _ in range(EPISODES):
            assert glue.rl_episode()
        assert glue.rl_num_episodes() == done + EPISODES
