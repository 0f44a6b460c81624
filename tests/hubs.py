"""A hub on a real socket, with players in threads: the cheapest way over the wire."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from threading import Thread

from glue import Agent, Environment, connect, serve_agent, serve_environment
from glue.core.config import HubConfig
from glue.core.experiment import Experiment
from glue.hub.server import Hub


@contextmanager
def hub_with(
    *, agents: dict[str, Agent] | None = None, environments: dict[str, Environment] | None = None
) -> Iterator[str]:
    """Serve players by session name at a hub; yield its address."""
    with Hub(HubConfig(bind=("tcp://127.0.0.1:*",))).in_background() as hub:
        address = hub.endpoints[0]
        serving = [
            Thread(target=serve, args=(players, address), kwargs={"log": lambda line: None})
            for serve, players in ((serve_agent, agents), (serve_environment, environments))
            if players
        ]
        for thread in serving:
            thread.start()
        yield address
    for thread in serving:
        thread.join()


@contextmanager
def over_the_hub(agent: Agent, environment: Environment) -> Iterator[Experiment]:
    """Yield an experiment with these players; between any two of the three is a hub."""
    with hub_with(agents={"default": agent}, environments={"default": environment}) as address:
        glue = connect(address, log=lambda line: None)
        with glue:
            yield glue
