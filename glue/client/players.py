"""Serve an agent or an environment at a hub.

    from glue import serve_agent

    class Lazy:
        def agent_init(self, task_spec): ...
        def agent_start(self, observation): return Action(ints=[0])
        ...

    serve_agent(Lazy())          # returns when the hub says goodbye

A hub that is not there yet is waited for. A connection that breaks is made again, and the episode goes on
as if nothing had happened.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from glue.client.answers import Players
from glue.client.link import Link, Log
from glue.client.place import Place, find_place
from glue.console import say, show_failure
from glue.errors import GlueError, HubClosed, PeerFailed
from glue.protocol.messages import CALLS, ErrorCode, Kind, Message, Role
from glue.protocol.wire import clip
from glue.roles import Agent, Environment

if TYPE_CHECKING:
    from glue.client.libzmq import Context

__all__ = ["serve_agent", "serve_environment"]


def serve_agent(
    agent: Agent | Mapping[str, Agent],
    hub: str | None = None,
    session: str | None = None,
    *,
    key: str | Path | None = None,
    hub_key: str | Path | None = None,
    wait: float | None = None,
    context: Context | None = None,
    log: Log = say,
) -> str:
    """Let `agent` take part in a session until the hub says goodbye; return the hub's reason.

    Args:
        agent: the agent; or a mapping from session names to agents, which serves several sessions over
            one connection.
        hub: URL of the hub; by default that of GLUE_HUB, with the keys of GLUE_KEY and GLUE_HUB_KEY, or
            else tcp://127.0.0.1:4097.
        session: name of the session, by default that of GLUE_SESSION; not used with a mapping.
        key: file with the secret key by which the hub knows the agent.
        hub_key: the hub's public key, or a file that holds it; needed with `key`.
        wait: seconds after which a hub that has not answered is given up; None waits forever.
        context: the ZeroMQ context, if the connection is to be libzmq's.
        log: receives lines for people; by default they go to standard error.

    Raises:
        ConfigError: an address, a key or a session name is malformed, or the host's name does not resolve.
        HubUnreachable: no hub has answered within `wait` seconds.
        Refused: the hub does not let it in, for instance because the session has an agent.
        PeerFailed: the agent lacks a method of its role, or raised; the hub is informed.
    """
    place = find_place(hub, session, key, hub_key)
    agents = agent if isinstance(agent, Mapping) else {place.session: agent}
    return _serve(Role.AGENT, agents, place, wait, context, log)


def serve_environment(
    environment: Environment | Mapping[str, Environment],
    hub: str | None = None,
    session: str | None = None,
    *,
    key: str | Path | None = None,
    hub_key: str | Path | None = None,
    wait: float | None = None,
    context: Context | None = None,
    log: Log = say,
) -> str:
    """Let `environment` take part in a session; arguments and errors are those of `serve_agent`."""
    place = find_place(hub, session, key, hub_key)
    environments = environment if isinstance(environment, Mapping) else {place.session: environment}
    return _serve(Role.ENVIRONMENT, environments, place, wait, context, log)


def _serve(
    role: Role,
    players: Mapping[str, Agent] | Mapping[str, Environment],
    place: Place,
    wait: float | None,
    context: Context | None,
    log: Log,
) -> str:
    served = Players(role, players)
    link = Link(role, place.hub, served.names, wait, context, log, key=place.key)
    reason = "interrupted"
    try:
        while True:
            message = link.receive()
            if message is None:
                continue
            player = served.get(message.session)
            if player is None:
                continue
            if message.kind is Kind.WELCOME:
                if not message.scalars[1]:
                    player.forget()
                    log(f"{role} {player.name} is in session {message.session!r} at {place.hub}")
            elif message.kind in CALLS:
                try:
                    served.answer(message, link)
                except Exception as error:
                    player = served.asked or player
                    call = player.last_call or message
                    what = call.kind.name.lower()
                    reason = f"{type(error).__name__} in {what}"
                    text = _report(link, call, error)
                    raise PeerFailed(f"{role} {player.name} raised in {what}: {text}") from error
    except HubClosed as goodbye:
        return str(goodbye)
    finally:
        link.close(reason)


def _report(link: Link, call: Message, error: Exception) -> str:
    """Print where the user's code failed; send the hub a short text, and return it."""
    if not isinstance(error, GlueError):
        show_failure(error)
    text = str(error) if isinstance(error, GlueError) else f"{type(error).__name__}: {error}"
    link.send(Message(Kind.ERROR, call.session, call.seq, (str(ErrorCode.EXCEPTION), clip(text))))
    return text
