"""A hub on a real socket, with players in threads: the cheapest setup that uses the wire."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager, suppress
from threading import Thread
from typing import Any

from glue import connect, serve_agent, serve_environment
from glue.engine.experiment import Experiment
from glue.errors import PeerFailed
from glue.hub.config import Bind, HubConfig
from glue.hub.io.server import Hub
from glue.roles import AgentLike, EnvironmentLike

Player = AgentLike | EnvironmentLike
Players = Player | Mapping[str, AgentLike] | Mapping[str, EnvironmentLike]
"""A player, or the players of one role by session name."""


@contextmanager
def serving(url: str, *players: Players) -> Iterator[None]:
    """Serve players, each in a thread; the hub must stop before the `with` block ends."""
    threads = [Thread(target=_serve, args=(player, url)) for player in players]
    for thread in threads:
        thread.start()
    yield
    for thread in threads:
        thread.join()


def _serve(player: Any, url: str) -> None:
    one = next(iter(player.values())) if isinstance(player, Mapping) else player
    serve: Any = serve_agent if hasattr(one, "agent_start") else serve_environment
    with suppress(PeerFailed):  # which the hub is told
        serve(player, url)


@contextmanager
def running(*players: Players, bind: str | Bind = "tcp://127.0.0.1:*", **settings: Any) -> Iterator[Hub]:
    """Serve players at a hub with these settings; yield the hub."""
    hub = Hub(HubConfig(bind=(bind,), **{"greeting": 60.0, **settings}))
    with serving(hub.endpoints[0], *players), hub.in_background():
        yield hub


@contextmanager
def hub_with(*players: Players, **settings: Any) -> Iterator[str]:
    """Serve players at a hub; yield its address."""
    with running(*players, **settings) as hub:
        yield hub.endpoints[0]


@contextmanager
def over_the_hub(agent: AgentLike, environment: EnvironmentLike, **settings: Any) -> Iterator[Experiment]:
    """Yield an experiment with these players; all three are connected by a hub."""
    with hub_with(agent, environment, **settings) as address, connect(address) as glue:
        yield glue
