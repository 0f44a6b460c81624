"""Serve an agent or an environment at a hub.

    from glue import serve_agent

    class Lazy(Agent):
        def agent_start(self, observation): return Action(ints=[0])
        def agent_step(self, reward, observation): return Action(ints=[0])

    serve_agent(Lazy())          # returns when the hub says goodbye

The player waits for a hub that is not there yet. A connection that breaks is made again, and the episode
continues as if nothing had happened.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from glue.client.answers import ServedPlayer, failure
from glue.client.link import Link
from glue.client.sockets import Transport
from glue.client.target import Target, find_target
from glue.console import LOG, reporting
from glue.errors import HubClosed, PeerFailed, Refused, described
from glue.roles import AgentLike, EnvironmentLike
from glue.system import threads
from glue.wire.codec import clip
from glue.wire.messages import CALL_KINDS, Event, Kind, Message, Role

if TYPE_CHECKING:
    from glue.client.libzmq import Context


def serve_agent(
    agent: AgentLike | Mapping[str, AgentLike],
    hub: str | None = None,
    session: str | None = None,
    *,
    key: str | Path | None = None,
    hub_key: str | Path | None = None,
    wait: float | None = None,
    context: Context | None = None,
    stop: threads.Event | None = None,
    name: str | None = None,
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
        wait: seconds to wait for the hub to answer before raising HubUnreachable; None waits forever.
        context: the ZeroMQ context, to connect through libzmq.
        stop: once it is set, the player leaves, after its current call or within a heartbeat.
        name: its name for people, in lines and in results; by default that of its class.

    Raises:
        ConfigError: an address, a key or a session name is malformed, or the host's name does not resolve.
        HubUnreachable: no hub has answered within `wait` seconds.
        Refused: the hub does not let it in, for instance because the session already has an agent.
        PeerFailed: the agent lacks a method of its role, or raised; the hub is informed.
    """
    target = find_target(hub, session, key, hub_key)
    agents = agent if isinstance(agent, Mapping) else {target.session: agent}
    return _serve(Role.AGENT, agents, target, wait, context, stop, name)


def serve_environment(
    environment: EnvironmentLike | Mapping[str, EnvironmentLike],
    hub: str | None = None,
    session: str | None = None,
    *,
    key: str | Path | None = None,
    hub_key: str | Path | None = None,
    wait: float | None = None,
    context: Context | None = None,
    stop: threads.Event | None = None,
    name: str | None = None,
) -> str:
    """Let `environment` take part in a session; arguments and errors are those of `serve_agent`."""
    target = find_target(hub, session, key, hub_key)
    environments = environment if isinstance(environment, Mapping) else {target.session: environment}
    return _serve(Role.ENVIRONMENT, environments, target, wait, context, stop, name)


def _serve(
    role: Role,
    players: Mapping[str, AgentLike] | Mapping[str, EnvironmentLike],
    target: Target,
    wait: float | None,
    context: Context | None,
    stop: threads.Event | None,
    name: str | None,
    transport: Transport | None = None,
) -> str:
    served = {session: ServedPlayer(role, player, name) for session, player in players.items()}
    names = {session: (player.name, player.capabilities) for session, player in served.items()}
    link = Link(role, target.hub, names, wait, context, transport, target.key)
    reason = "interrupted"
    message: Message | None = None

    def report(line: str) -> None:
        if message is not None and message[0] in CALL_KINDS:
            scalars = (str(Event.SLOW), str(role), clip(line))
            link.send(Message(Kind.NOTICE, message.session, message.seq, scalars))

    try:
        with reporting(report):
            while stop is None or not stop.is_set():
                message = link.receive()
                if message is None:
                    continue
                player = served.get(message.session)
                if player is None:
                    continue
                if message[0] in CALL_KINDS:
                    try:
                        answer = player.answer(message)
                        if answer is not None:
                            link.send(answer)
                    except (KeyboardInterrupt, SystemExit):
                        raise
                    except BaseException as error:  # also asyncio.CancelledError and GeneratorExit
                        what = message.kind.name.lower()
                        reason = f"{type(error).__name__} in {what}"
                        link.send(failure(message, error))
                        text = f"{role} {player.name} raised in {what}: {described(error)}"
                        raise PeerFailed(text) from error
                elif message.kind is Kind.WELCOME:
                    player.welcome(message)
                    if not message.scalars[1]:
                        player.forget()
                        LOG.info(
                            "%s %s is in session %r at %s", role, player.name, message.session, target.hub
                        )
        reason = "stopped"
        return reason
    except HubClosed as goodbye:
        reason = f"the hub said goodbye to it in another session: {goodbye}"
        return str(goodbye)
    except Refused as refusal:
        reason = str(refusal)  # for the sessions that have let the player in
        raise
    finally:
        link.close(reason)
