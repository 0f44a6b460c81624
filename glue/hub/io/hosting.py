"""A session in this process, which a player from outside joins."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from glue.client.experiment import connect_over
from glue.engine.experiment import Experiment
from glue.errors import ConfigError
from glue.hub.config import DEFAULT_HUB, DEFAULT_SESSION, HubConfig
from glue.hub.io.inside import InsideTransport
from glue.hub.io.server import Hub
from glue.roles import AgentLike, EnvironmentLike
from glue.wire.messages import Role


@contextmanager
def host(
    agent: AgentLike | None = None,
    environment: EnvironmentLike | None = None,
    *,
    bind: str = DEFAULT_HUB,
    session: str = DEFAULT_SESSION,
) -> Iterator[Experiment]:
    """Run a hub in this process, with these players as objects; yield its experiment.

    A player that is not given joins from outside, written in any language; verbs wait for it:

        with glue.host(environment=MyEnvironment()) as experiment:   # elsewhere: glue-agent sarsa
            experiment.rl_init(seed=1)
            experiment.rl_episode(max_steps=1000)

    A step is then one round trip between processes. With both players here, `glue.local` needs no hub at all.

    Args:
        agent: the agent; None to wait for one.
        environment: the environment; None to wait for one.
        bind: address at which players join, `tcp://HOST:PORT` or `ipc://PATH`; only from this machine.
        session: the session's name.

    Raises:
        ConfigError: the address is in use or can be reached from other machines, or no player is given.
        PeerFailed: a player lacks a method of its role.
    """
    given = ((Role.AGENT, agent), (Role.ENVIRONMENT, environment))
    players = {role: player for role, player in given if player is not None}
    if not players:
        raise ConfigError("give an agent or an environment; if both join from outside, use glue.connect")
    with Hub(HubConfig(bind=(bind,))) as hub:
        transport = InsideTransport(hub, players, session)
        with hub.in_background(), connect_over(transport, session) as experiment:
            yield experiment
