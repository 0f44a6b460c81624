"""Serve an agent or an environment at a hub.

    from glue import serve_agent

    class Lazy:
        def agent_init(self, task_spec): ...
        def agent_start(self, observation): return Action(ints=[0])
        ...

    serve_agent(Lazy())          # returns when the hub says goodbye

A hub that is not there yet is waited for; a connection that breaks is made again, and the episode goes
on as if nothing had happened.
"""

from __future__ import annotations

import traceback
from collections.abc import Mapping
from typing import Any

from glue.client.bodies import READ, write
from glue.client.link import Link, Log
from glue.client.transport import Context
from glue.console import say
from glue.core.calls import Handler, name_of, role_calls
from glue.core.config import DEFAULT_HUB, DEFAULT_SESSION
from glue.errors import GlueError, HubClosed, PeerFailed, RemoteProtocolError
from glue.protocol.messages import CALLS, ErrorCode, Kind, Message, Role
from glue.protocol.wire import clip
from glue.roles import Agent, Environment, capabilities

__all__ = ["serve_agent", "serve_environment"]


def serve_agent(
    agent: Agent | Mapping[str, Agent], hub: str = DEFAULT_HUB, session: str = DEFAULT_SESSION, **how: Any
) -> str:
    """Let `agent` take part in a session until the hub says goodbye; return the hub's reason.

    A mapping from session names to agents serves several sessions over one connection.

    Raises:
        ConfigError: an address or a session name is malformed.
        Refused: the hub does not let it in, for instance because the session has an agent.
        PeerFailed: the agent raised an exception; the hub was told.
    """
    return _serve(Role.AGENT, agent, hub, session, **how)


def serve_environment(
    environment: Environment | Mapping[str, Environment],
    hub: str = DEFAULT_HUB,
    session: str = DEFAULT_SESSION,
    **how: Any,
) -> str:
    """Let `environment` take part in a session; as `serve_agent`."""
    return _serve(Role.ENVIRONMENT, environment, hub, session, **how)


class _Player:
    """One agent or environment, in one session: what it can be asked, and its last answer."""

    def __init__(self, role: Role, player: Any) -> None:
        self.name = name_of(player)
        self.handlers: dict[Kind, Handler] = role_calls(role, player)
        self.last_seq = 0
        self.last_answer: Message | None = None

    def welcome(self, resumed: bool) -> None:
        """A hub that does not know this player counts its calls from the start."""
        if not resumed:
            self.last_seq = 0
            self.last_answer = None

    def answer(self, message: Message) -> Message | None:
        """Return the answer to a call; the same one if the call is repeated; none if it is outdated."""
        kind, session, seq, scalars, body = message
        if seq <= self.last_seq:
            return self.last_answer if seq == self.last_seq else None
        handler = self.handlers.get(kind)
        if handler is None:
            raise RemoteProtocolError(f"the hub asked {self.name} for {kind.name}")
        replied, result = handler(scalars, READ[CALLS[kind].request.body](body))
        answer = Message(kind, session, seq, replied, write(result))
        self.last_seq = seq
        self.last_answer = answer
        return answer


def _serve(
    role: Role,
    players: Any,
    hub: str,
    session: str,
    *,
    context: Context | None = None,
    log: Log | None = None,
) -> str:
    log = log or say
    by_session = players if isinstance(players, Mapping) else {session: players}
    served = {name: _Player(role, player) for name, player in by_session.items()}
    abilities = {name: (served[name].name, capabilities(player)) for name, player in by_session.items()}
    link = Link(role, hub, abilities, context, log)
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
                resumed = bool(message.scalars[1])
                player.welcome(resumed)
                if not resumed:
                    log(f"{role} {player.name} is in session {message.session!r} at {hub}")
            elif message.kind in CALLS:
                try:
                    answer = player.answer(message)
                    if answer is not None:
                        link.send(answer)
                except Exception as error:
                    reason = f"{type(error).__name__} in {message.kind.name.lower()}"
                    text = _report(link, message, error)
                    what = message.kind.name.lower()
                    raise PeerFailed(f"{role} {player.name} raised in {what}: {text}") from error
    except HubClosed as goodbye:
        reason = "goodbye"
        return str(goodbye)
    finally:
        link.close(reason)


def _report(link: Link, message: Message, error: Exception) -> str:
    """Show the user's own mistake where it happened; tell the hub in a few words, and return them."""
    if not isinstance(error, GlueError):
        traceback.print_exception(error)
    text = str(error) if isinstance(error, GlueError) else f"{type(error).__name__}: {error}"
    link.send(Message(Kind.ERROR, message.session, message.seq, (str(ErrorCode.EXCEPTION), clip(text))))
    return text
