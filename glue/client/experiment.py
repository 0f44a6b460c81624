"""An experiment's connection to a hub.

from glue import connect

with connect() as glue:
    glue.rl_init(seed=1)
    glue.rl_episode()
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Final

from glue.client.bodies import READ, write
from glue.client.link import Link, Log
from glue.client.transport import Context
from glue.console import say
from glue.core.config import DEFAULT_HUB, DEFAULT_SESSION
from glue.core.experiment import Experiment
from glue.errors import GlueError, HubClosed, LocalProtocolError, PeerFailed, PeerLost, Unsupported
from glue.protocol.messages import CALLS, ErrorCode, Event, Kind, Message, Role, Value

__all__ = ["RemoteExperiment", "connect"]


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
    return RemoteExperiment(hub, session, name, context, log or say, on_notice)


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
        self._link = Link(Role.EXPERIMENT, hub, {session: (name, ())}, context, log)
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
        request = Message(kind, self._session, self._seq, scalars, write(body))
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
                    return message.scalars, READ[CALLS[kind].reply.body](message.body)

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
