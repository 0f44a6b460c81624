"""Connect an agent, an environment or an experiment to a hub.

    from glue.client import serve_agent

    class Lazy:
        def agent_init(self, task_spec): ...
        def agent_start(self, observation): return Action(ints=[0])
        ...

    serve_agent(Lazy())          # returns when the hub says goodbye

    from glue.client import connect

    with connect() as glue:      # an experiment
        glue.rl_init(seed=1)
        glue.rl_episode()

A hub that is not there yet is waited for; a connection that breaks is made again, and the episode goes
on as if nothing had happened.
"""

from __future__ import annotations

import os
import platform
import sys
import time
import traceback
from collections.abc import Callable, Mapping
from typing import Any, Final

import zmq

from glue.calls import Handler, name_of, role_calls
from glue.config import DEFAULT_HUB, DEFAULT_SESSION, check_session, check_url
from glue.errors import (
    GlueError,
    HubClosed,
    LocalProtocolError,
    PeerFailed,
    PeerLost,
    Refused,
    RemoteProtocolError,
    Unsupported,
)
from glue.experiment import Experiment
from glue.messages import CALLS, PROTOCOL_VERSION, Body, ErrorCode, Event, Kind, Message, Role, Value
from glue.roles import Agent, Environment, capabilities
from glue.sessions import INSTANCE_SIZE
from glue.types import Action, Observation, body_size
from glue.wire import FROM_HUB, MAX_BODY, MAX_HEADER, TO_HUB, UnknownKind, clip, decode, encode
from glue.zmq_transport import Context, DealerTransport

__all__ = ["RemoteExperiment", "connect", "serve_agent", "serve_environment"]

Log = Callable[[str], None]

_CODEC: Final = f"Python {platform.python_version()}"
_HEARTBEAT: Final = 1.0
_PATIENCE: Final = 5.0


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


def connect(
    hub: str = DEFAULT_HUB,
    session: str = DEFAULT_SESSION,
    *,
    name: str = "experiment",
    context: Context | None = None,
    log: Log | None = None,
    on_notice: Callable[[str, str, str], None] | None = None,
) -> RemoteExperiment:
    """Return an experiment of `session` at `hub`, once the hub has let it in.

    Args:
        hub: URL of the hub; it is waited for.
        session: name of the session.
        name: what the hub calls this program in its messages.
        context: the ZeroMQ context; one on `inproc://` needs the hub's.
        log: takes lines for people (default: standard error).
        on_notice: called with event (`joined`, `lost`, `returned`), role and name of a player.

    Raises:
        ConfigError: an address or a session name is malformed.
        Refused: the hub does not let it in.
    """
    return RemoteExperiment(hub, session, name, context, log or _to_stderr, on_notice)


def _to_stderr(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


class _Link:
    """A peer's connection: greetings, signs of life, and coming back after a break."""

    def __init__(
        self,
        role: Role,
        hub: str,
        names: Mapping[str, tuple[str, tuple[str, ...]]],
        context: Context | None,
        log: Log,
    ) -> None:
        check_url(hub)
        self._role = role
        self._hub = hub
        self._names = {check_session(session): name for session, name in names.items()}
        self._log = log
        self._instance = os.urandom(INSTANCE_SIZE)
        self._max_body = MAX_BODY
        self._heartbeat, self._patience = _HEARTBEAT, _PATIENCE
        self._welcomed: set[str] = set()
        self._transport = DealerTransport(
            context or zmq.Context.instance(), hub, _PATIENCE, 2 * MAX_BODY + MAX_HEADER
        )
        self._transport.wait_at_most(_HEARTBEAT)
        self._heard = time.monotonic()
        self._silent = False
        for session in self._names:
            self._hello(session)

    def _hello(self, session: str) -> None:
        self._welcomed.discard(session)
        name, abilities = self._names[session]
        scalars = ((PROTOCOL_VERSION,), str(self._role), self._instance, name, _CODEC, abilities)
        self.send(Message(Kind.HELLO, session, 0, scalars))

    def send(self, message: Message) -> None:
        """Send; what cannot be sent now will be asked for again by the hub, or repeated."""
        if len(message.body) > self._max_body:
            raise LocalProtocolError(
                f"the body of {message.kind.name} has {len(message.body)} bytes; "
                f"the hub takes {self._max_body}"
            )
        self._transport.send(encode(message, TO_HUB))

    def receive(self) -> Message | None:
        """Return the next message that is not about the connection, or None when nothing comes.

        Raises:
            HubClosed, Refused: the hub said so.
        """
        frames = self._transport.receive()
        if frames is None:
            self._idle()
            return None
        if self._silent:
            self._silent = False
            self._log(f"the hub at {self._hub} is there")
        self._heard = time.monotonic()
        try:
            message = decode(frames, FROM_HUB, self._max_body)
        except UnknownKind as error:
            # A newer hub may know more; a call that is answered so has failed.
            code = str(ErrorCode.UNKNOWN_KIND)
            self.send(Message(Kind.ERROR, error.session, error.seq, (code, str(error))))
            return None
        if message.kind in CALLS:
            return message
        return self._control(message)

    def _control(self, message: Message) -> Message | None:
        kind, session, _, scalars, _ = message
        if kind is Kind.HEARTBEAT:
            return None
        if kind is Kind.GOODBYE:
            raise HubClosed(str(scalars[0]))
        if kind is Kind.REFUSE:
            raise Refused(f"the hub at {self._hub} refused this {self._role}: {scalars[1]!s}")
        if kind is Kind.ERROR and scalars[0] == ErrorCode.UNKNOWN_PEER:
            if session in self._welcomed:
                # The connection is a new one, so the hub knows it in no session.
                for known in self._names:
                    self._hello(known)
            return None
        if kind is Kind.WELCOME and session in self._names:
            _, _, heartbeat, patience, max_body = scalars
            assert isinstance(heartbeat, float)
            assert isinstance(patience, float)
            assert isinstance(max_body, int)
            self._heartbeat = min(max(heartbeat, 0.01), 60.0)
            self._patience = max(patience, self._heartbeat)
            self._max_body = min(max_body, MAX_BODY)
            self._transport.wait_at_most(self._heartbeat)
            self._welcomed.add(session)
        return message

    def _idle(self) -> None:
        """Nothing came for a heartbeat: show a sign of life, or greet again."""
        alone = not self._welcomed or time.monotonic() - self._heard >= self._patience
        if alone and not self._silent:
            self._silent = True
            self._log(
                f"no hub at {self._hub} yet; waiting for one "
                f"(glue-experiment brings its own, glue-hub is one alone)"
            )
        for session in self._names:
            if session in self._welcomed:
                self.send(Message(Kind.HEARTBEAT, session, 0))
            else:
                self._hello(session)

    def close(self, reason: str) -> None:
        """Say goodbye to the hub, if there is one, and close."""
        for session in self._welcomed:
            self._transport.send(encode(Message(Kind.GOODBYE, session, 0, (clip(reason),)), TO_HUB))
        self._transport.close(None if self._welcomed else 0)


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
        replied, result = handler(scalars, _READ[CALLS[kind].request.body](body))
        answer = Message(kind, session, seq, replied, _write(result))
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
    log = log or _to_stderr
    by_session = players if isinstance(players, Mapping) else {session: players}
    served = {name: _Player(role, player) for name, player in by_session.items()}
    abilities = {name: (served[name].name, capabilities(player)) for name, player in by_session.items()}
    link = _Link(role, hub, abilities, context, log)
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


def _report(link: _Link, message: Message, error: Exception) -> str:
    """Show the user's own mistake where it happened; tell the hub in a few words, and return them."""
    if not isinstance(error, GlueError):
        traceback.print_exception(error)
    text = str(error) if isinstance(error, GlueError) else f"{type(error).__name__}: {error}"
    link.send(Message(Kind.ERROR, message.session, message.seq, (str(ErrorCode.EXCEPTION), clip(text))))
    return text


class RemoteExperiment(Experiment):
    """RL-Glue's verbs over a hub. Made by `connect`."""

    def __init__(
        self,
        hub: str,
        session: str,
        name: str,
        context: Context | None,
        log: Log,
        on_notice: Callable[[str, str, str], None] | None,
    ) -> None:
        self._session = session
        self._on_notice = on_notice
        self._seq = 0
        self._players: set[Role] = set()
        self._loss: str | None = None
        self._given_up: str | None = None
        self._link = _Link(Role.EXPERIMENT, hub, {session: (name, ())}, context, log)
        self._closed = False
        try:
            while not self._welcomed(self._link.receive()):
                pass
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Leave the session."""
        if not self._closed:
            self._closed = True
            self._link.close("the experiment is over")

    def give_up(self, reason: str) -> None:
        """Let whatever verb is waiting, or the next, raise HubClosed; may be called from any thread."""
        self._given_up = reason

    def wait_for_players(self, tell: Callable[[frozenset[Role]], None]) -> None:
        """Return when the session has an agent and an environment.

        `tell` is called with the roles that are missing, after a moment of grace and whenever they change.
        """
        told: frozenset[Role] | None = None
        while missing := frozenset({Role.AGENT, Role.ENVIRONMENT}) - self._players:
            message = self._receive()
            if message is not None and message.kind is Kind.NOTICE:
                self._notice(message)
            elif missing != told:
                told = missing
                tell(missing)

    def _receive(self) -> Message | None:
        if self._given_up is not None:
            raise HubClosed(self._given_up)
        return self._link.receive()

    def _welcomed(self, message: Message | None) -> bool:
        if message is not None and message.kind is Kind.NOTICE:
            self._notice(message)
        return message is not None and message.kind is Kind.WELCOME

    def _notice(self, message: Message) -> None:
        event, role, name = map(str, message.scalars)
        if event == Event.LOST:
            self._players.discard(Role(role))
            self._loss = f"the {role} {name} was lost between two verbs, and another is in its place"
        else:
            self._players.add(Role(role))
        if self._on_notice is not None:
            self._on_notice(event, role, name)

    def _call(self, kind: Kind, scalars: tuple[Value, ...] = (), body: Any = None) -> tuple[Any, Any]:
        link = self._link
        self._seq += 1
        request = Message(kind, self._session, self._seq, scalars, _write(body))
        link.send(request)
        while True:
            message = self._receive()
            if message is None:
                continue
            if message.kind is Kind.NOTICE:
                self._notice(message)
            elif message.kind is Kind.WELCOME:
                if not message.scalars[1]:
                    raise HubClosed(
                        "the hub knows nothing of this experiment: it was started anew, or had given us up"
                    )
                link.send(request)
            elif message.seq == self._seq:
                if message.kind is Kind.ERROR:
                    code, text = message.scalars
                    if code in (ErrorCode.PEER_LOST, ErrorCode.PEER_FAILED):
                        self._loss = None
                    raise _ERRORS.get(str(code), LocalProtocolError)(str(text))
                if message.kind is kind:
                    if self._loss is not None and kind in _DEPENDENT:
                        self._lament(kind)
                    return message.scalars, _READ[CALLS[kind].reply.body](message.body)

    def _lament(self, kind: Kind) -> None:
        """Raise PeerLost for a loss that no verb has failed of, unless this one has made up for it."""
        loss, self._loss = self._loss, None
        if kind is not Kind.RL_INIT:
            raise PeerLost(loss)


_DEPENDENT: Final = frozenset(
    {Kind.RL_INIT, Kind.RL_START, Kind.RL_EPISODE, Kind.RL_AGENT_SAVE, Kind.RL_ENV_SAVE}
)
"""Verbs that succeed with a player that has taken another's place, and mean something else then."""

_ERRORS: Final[Mapping[str, type[GlueError]]] = {
    ErrorCode.PEER_LOST: PeerLost,
    ErrorCode.PEER_FAILED: PeerFailed,
    ErrorCode.UNSUPPORTED: Unsupported,
}


def _read_text(body: bytes) -> str:
    # Original RL-Glue programs send whatever bytes they like; they survive the way there and back.
    return body.decode("utf-8", "surrogateescape")


def _read_both(body: bytes) -> tuple[Observation, Action]:
    size = body_size(body)
    return Observation.from_body(body[:size]), Action.from_body(body[size:])


_READ: Final[Mapping[Body, Callable[[bytes], Any]]] = {
    Body.NONE: lambda body: None,
    Body.OBSERVATION: Observation.from_body,
    Body.ACTION: Action.from_body,
    Body.OBSERVATION_ACTION: _read_both,
    Body.TEXT: _read_text,
    Body.BLOB: bytes,
}


def _write(value: Any) -> bytes:
    if value is None:
        return b""
    if type(value) is str:
        try:
            return value.encode("utf-8", "surrogateescape")
        except UnicodeEncodeError as error:
            raise LocalProtocolError(
                f"{value!r:.80} is no text that UTF-8 can carry: {error.reason}"
            ) from None
    if type(value) is bytes:
        return value
    body: bytes = value.body
    return body
