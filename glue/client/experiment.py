"""An experiment's connection to a hub.

from glue import connect

with connect() as glue:
    glue.rl_init(seed=1)
    glue.rl_episode()
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from glue.client.bodies import READ, write
from glue.client.link import Link
from glue.client.sockets import Transport
from glue.client.target import Target, find_target
from glue.console import LOG, one_line
from glue.engine.experiment import Experiment
from glue.errors import GlueError, HubClosed, LocalProtocolError, PeerFailed, PeerLost, Unsupported
from glue.hub.config import DEFAULT_SESSION
from glue.types import Observation, has_beside
from glue.wire.beside import carried, readable_by_agent
from glue.wire.messages import (
    BESIDE,
    CALLS,
    OUTCOME,
    PACE,
    PLAYERS,
    ErrorCode,
    Event,
    Kind,
    Message,
    Role,
    Value,
)

if TYPE_CHECKING:
    from glue.client.libzmq import Context

WAIT_SECONDS: Final = 10.0
"""Seconds to wait for a hub by default."""

OnNotice = Callable[[Event, Role, str], None]
"""A function of an event, and a player's role and name; the reason follows the name of a slow player."""


def connect(
    hub: str | None = None,
    session: str | None = None,
    *,
    key: str | Path | None = None,
    hub_key: str | Path | None = None,
    name: str = "experiment",
    wait: float | None = WAIT_SECONDS,
    context: Context | None = None,
    on_notice: OnNotice | None = None,
) -> RemoteExperiment:
    """Return an experiment of `session` at `hub`, once the hub has let it in.

    Args:
        hub: URL of the hub; by default that of GLUE_HUB, with the keys of GLUE_KEY and GLUE_HUB_KEY, or
            else tcp://127.0.0.1:4097.
        session: name of the session, by default that of GLUE_SESSION.
        key: file with the secret key by which the hub knows this program.
        hub_key: the hub's public key, or a file that holds it; needed with `key`.
        name: name of this program in messages of the hub.
        wait: seconds to wait for the hub to answer before raising HubUnreachable; None waits for ever.
        context: the ZeroMQ context, to connect through libzmq.
        on_notice: called when a player joins, is lost, returns or is slow, with the event, its role and its
            name; the reason follows the name of a slow player. Without it, slow players are logged.

    Raises:
        ConfigError: an address, a key or a session name is malformed, or the host's name does not resolve.
        HubUnreachable: no hub has answered within `wait` seconds.
        Refused: the hub does not let it in.
    """
    target = find_target(hub, session, key, hub_key)
    return RemoteExperiment(target, name, wait, context, on_notice)


def connect_over(
    transport: Transport,
    session: str = DEFAULT_SESSION,
    *,
    name: str = "experiment",
    on_notice: OnNotice | None = None,
    num_steps: Callable[[], int] | None = None,
) -> RemoteExperiment:
    """Return an experiment of `session` over an open connection, once the hub has let it in.

    Args:
        transport: the connection, such as `glue.hub.io.inside.InsideTransport`.
        session: name of the session.
        name: as for `connect`.
        on_notice: as for `connect`.
        num_steps: returns RL_num_steps from any thread; None if the hub is not in this process.

    Raises:
        ConfigError: the session name is malformed.
        Refused: the hub does not let it in.
    """
    target = Target("inside", session)
    return RemoteExperiment(target, name, None, None, on_notice, transport, num_steps)


class RemoteExperiment(Experiment):
    """RL-Glue's verbs over a hub. Made by `connect`."""

    def __init__(
        self,
        target: Target,
        name: str,
        wait: float | None,
        context: Context | None,
        on_notice: OnNotice | None,
        transport: Transport | None = None,
        num_steps: Callable[[], int] | None = None,
    ) -> None:
        self._num_steps = num_steps
        self._session = session = target.session
        self._on_notice = on_notice
        self._seq = 0
        self._answered = False  # whether the hub has answered a request since it last reported us unknown
        self._players: set[Role] = set()
        self._loss: str | None = None
        # The loss known at the last WELCOME, until the next reply.
        self._loss_before: tuple[str | None] | None = None
        self._given_up: str | None = None
        self._outcome: Mapping[Kind, tuple[Value, ...]] = {}
        self._carries: frozenset[str] = frozenset()
        names = {session: (name, (*sorted(BESIDE), OUTCOME, PACE))}
        self._link = Link(Role.EXPERIMENT, target.hub, names, wait, context, transport, target.key)
        self._closed = False
        try:
            while not self._link.ready(session):
                self._receive()
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """Leave the session."""
        if not self._closed:
            self._closed = True
            self._link.close("the experiment is over")

    def steps_under_way(self) -> int | None:
        return None if self._num_steps is None else self._num_steps()

    def late_actions(self) -> int | None:
        if PACE not in self._carries:
            return None
        self._outcome = {}  # it does not include this
        (_, late), _ = self._call(Kind.RL_NUM_STEPS)
        return int(late)

    def give_up(self, reason: str) -> None:
        """Make the verb that is waiting, or the next one, raise HubClosed; callable from any thread."""
        self._given_up = reason

    def wait_for_players(self, report: Callable[[frozenset[Role]], None]) -> None:
        """Return when the session has an agent and an environment.

        `report` is called with the missing roles, after a short delay and whenever they change.
        """
        reported: frozenset[Role] | None = None
        while missing := _PLAYERS - self._players:
            message = self._receive()
            if missing != reported and (message is None or message.kind is not Kind.NOTICE):
                reported = missing
                report(missing)

    def _receive(self) -> Message | None:
        """Return the next message, having acted on it if it is a WELCOME or a NOTICE.

        Raises:
            HubClosed: the hub ended the session or has forgotten this experiment, or `give_up` was called.
        """
        if self._given_up is not None:
            raise HubClosed(self._given_up)
        message = self._link.receive()
        if message is not None:
            if message.kind is Kind.NOTICE:
                self._notice(message)
            elif message.kind is Kind.WELCOME:
                self._carries = carried(message)
                self._welcome(resumed=bool(message.scalars[1]))
        return message

    def _welcome(self, resumed: bool) -> None:
        # The hub will now say which players were lost, and which are there.
        self._players.clear()
        self._loss_before = (self._loss,)
        if not resumed and self._answered:
            self._answered = False
            raise HubClosed(
                "the hub knows nothing of this experiment: it was restarted, or had given this experiment up"
            )

    def _notice(self, message: Message) -> None:
        event, role, name = (one_line(str(scalar)) for scalar in message.scalars)
        if event not in _EVENTS or role not in _PLAYERS:
            return  # from a newer hub
        if event == Event.SLOW:
            if self._on_notice is None:
                LOG.warning("%s %s", role, name)
        elif event == Event.LOST:
            self._players.discard(Role(role))
            self._loss = f"the {role} {name} was lost between two verbs, and another is in its place"
        else:
            self._players.add(Role(role))
        if self._on_notice is not None:
            self._on_notice(Event(event), Role(role), name)

    def _call(self, kind: Kind, scalars: tuple[Value, ...] = (), body: Any = None) -> tuple[Any, Any]:
        known = self._outcome.get(kind)
        if known is not None:
            return known, None
        self._outcome = {}
        link = self._link
        self._seq += 1
        data = write(body)
        if isinstance(body, Observation) and has_beside(data):
            data = readable_by_agent(data, self._carries)
        request = Message(kind, self._session, self._seq, scalars, data)
        unreceived = 0  # how often the request was sent and, as far as is known, not received
        if link.ready(self._session):
            link.send(request)
            unreceived = 1
        while True:
            message = self._receive()
            if message is None:
                continue
            if message.kind is Kind.WELCOME:
                # Over a new connection the request is sent again; the hub recognises a repetition.
                if link.ready(self._session):
                    if message.scalars[1]:
                        unreceived = 0
                    if unreceived == _MAX_SENDS:
                        raise HubClosed(
                            f"the connection to the hub ended {_MAX_SENDS} times in succession after "
                            f"{kind.name} was sent; the hub's log may say why"
                        )
                    link.send(request)
                    unreceived += 1
            elif message.seq == self._seq:
                if message.kind is Kind.ERROR:
                    self._answered = True
                    raise self._error(message)
                if message.kind is kind:
                    self._answered = True
                    self._loss_before = None
                    if self._loss is not None and kind in _DEPENDENT:
                        # A loss that has made no verb fail yet, which only RL_init makes up for.
                        loss, self._loss = self._loss, None
                        if kind is not Kind.RL_INIT:
                            raise PeerLost(loss)
                    return self._without_outcome(message), READ[CALLS[kind].reply.body](message.body)
            elif self._loss_before is not None and message.kind in CALLS:
                # The previous reply, repeated: losses reported before it were known before this request.
                (self._loss,), self._loss_before = self._loss_before, None

    def _without_outcome(self, reply: Message) -> tuple[Value, ...]:
        """Return the scalars of a reply; keep the return and number of steps of an episode, if included."""
        scalars = reply.scalars
        if reply.kind is not Kind.RL_EPISODE or len(scalars) == 1:
            return scalars
        terminal, total_reward, num_steps = scalars
        self._outcome = {Kind.RL_RETURN: (total_reward,), Kind.RL_NUM_STEPS: (num_steps,)}
        return (terminal,)

    def _error(self, message: Message) -> GlueError:
        """Return the exception for an ERROR in answer to a request."""
        code, text = (one_line(str(scalar)) for scalar in message.scalars)
        if code in (ErrorCode.PEER_LOST, ErrorCode.PEER_FAILED):
            self._loss = None
        return ERRORS.get(code, LocalProtocolError)(text)


_EVENTS: Final = frozenset(Event)
_PLAYERS: Final = frozenset(PLAYERS)

_MAX_SENDS: Final = 8
"""Maximum number of attempts to send a request to a hub that has not received it, one per connection.

The request itself may make the hub drop the connection, through an error in the hub."""

_DEPENDENT: Final = frozenset(
    {
        Kind.RL_INIT,
        Kind.RL_START,
        Kind.RL_EPISODE,
        Kind.RL_ENV_START,
        Kind.RL_AGENT_START,
        Kind.RL_AGENT_SAVE,
        Kind.RL_ENV_SAVE,
    }
)
"""Verbs that succeed with a player that has replaced another, but then mean something else."""

ERRORS: Final[Mapping[str, type[GlueError]]] = {
    ErrorCode.PEER_LOST: PeerLost,
    ErrorCode.PEER_FAILED: PeerFailed,
    ErrorCode.UNSUPPORTED: Unsupported,
}
"""The exceptions for the codes of an ERROR, which an experiment may expect of its players."""
