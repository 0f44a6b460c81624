"""A peer's connection to a hub: greetings, heartbeats, and reconnecting after a break.

A hub knows a peer by its connection, so the peer greets the hub once over each. Until the hub has welcomed
the peer over the latest connection, anything else sent there is ignored: a different hub may be listening.
"""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from glue.client.sockets import Transport, open_transport
from glue.client.target import OwnKey
from glue.console import LOG, one_line
from glue.errors import ConfigError, HubClosed, HubUnreachable, LocalProtocolError, Refused
from glue.hub.config import check_session
from glue.hub.sessions import INSTANCE_SIZE
from glue.system import chance, clock, spinning
from glue.system.spinning import LONG_SPIN_SECONDS, SPIN_SECONDS, Spin, cores_are_free
from glue.wire.codec import UnknownKind, clip
from glue.wire.messages import CALL_KINDS, MAX_BODY, PLAYERS, PROTOCOL_VERSION, ErrorCode, Kind, Message, Role

if TYPE_CHECKING:
    from glue.client.libzmq import Context


_CODEC: Final = f"Python {platform.python_version()}"
_HEARTBEAT: Final = 1.0
_TIMEOUT: Final = 5.0


class Link:
    """Successive connections to a hub, for one program in one or more sessions.

    Args:
        role: role of the program in each session.
        hub: URL of the hub.
        names: for each session, the name to show to people, and the capabilities offered.
        wait: seconds to wait to be welcomed before raising HubUnreachable; None waits forever.
        context: the ZeroMQ context, to connect through libzmq.
        transport: the connection, if there is one already; `hub` is then only shown to people.
        key: the key by which the hub knows the program, if any.

    Raises:
        ConfigError: an address or a session name is malformed, or the host's name does not resolve.
    """

    def __init__(
        self,
        role: Role,
        hub: str,
        names: Mapping[str, tuple[str, tuple[str, ...]]],
        wait: float | None,
        context: Context | None,
        transport: Transport | None = None,
        key: OwnKey | None = None,
    ) -> None:
        if wait is not None and not wait >= 0:
            raise ConfigError(f"the seconds to wait for a hub are 0 or more, not {wait}")
        self._role = role
        self._hub = hub
        self._names = {check_session(session): name for session, name in names.items()}
        self._wait = wait
        self._process = os.getpid()
        self._instance = chance.random_bytes(INSTANCE_SIZE)
        self._max_body = MAX_BODY
        self._heartbeat, self._timeout = _HEARTBEAT, _TIMEOUT
        self._transport = transport or open_transport(hub, context, key)
        self._transport.wait_at_most(_HEARTBEAT if wait is None else min(_HEARTBEAT, wait))
        if spinning.SEVERAL_CORES:
            if any("batch" in capabilities for _, capabilities in names.values()):
                self._transport.spin_with(Spin(LONG_SPIN_SECONDS))
            elif role in PLAYERS and len(names) == 1:  # calls in several sessions come together
                self._transport.spin_with(Spin(SPIN_SECONDS, cores_are_free))
        self._greeted = 0  # number of the connection that was greeted last; also the `seq` of that HELLO
        self._welcomed: dict[str, None] = {}  # sessions joined over that connection, in order
        self._known = False  # whether a hub has ever welcomed us
        self._started = self._received = clock.monotonic()
        self._heard = False  # whether a message was received since the last heartbeat
        self._silent = False

    @property
    def connected(self) -> bool:
        """Whether there is a connection to a hub, as far as `receive` has noticed."""
        return self._transport.connected

    def ready(self, session: str) -> bool:
        """Return whether the hub has welcomed us in `session` over the connection that was greeted last.

        An experiment sends its requests only then: a request sent along with a HELLO could reach a hub that
        knows nothing of earlier requests.
        """
        return session in self._welcomed

    def send(self, message: Message) -> None:
        """Send a message. If it is lost with the connection, the hub asks for it again, or it is repeated.

        Raises:
            LocalProtocolError: the body is larger than the hub accepts, or this is a fork of the process that
                has made the connection.
        """
        if os.getpid() != self._process:
            raise self._forked()
        if len(message[4]) > self._max_body:
            kind, size = message.kind.name, len(message.body)
            raise LocalProtocolError(f"the body of {kind} has {size} bytes; the hub takes {self._max_body}")
        self._transport.send_message(message)

    def receive(self) -> Message | None:
        """Return the next call, reply, ERROR, NOTICE or WELCOME; None if there is none for a heartbeat.

        Raises:
            HubClosed: the hub said goodbye.
            HubUnreachable: no hub has answered in the time allowed.
            Refused: the hub does not admit us.
            LocalProtocolError: this is a fork of the process that has made the connection.
        """
        if os.getpid() != self._process:
            raise self._forked()
        try:
            message = self._transport.receive_message(self._max_body)
        except UnknownKind as error:
            # A newer hub may know more kinds; a call that is answered in this way has failed.
            self._end_silence()
            code = str(ErrorCode.UNKNOWN_KIND)
            self.send(Message(Kind.ERROR, error.session, error.seq, (code, str(error))))
            return None
        if message is None:
            self._idle()
            return None
        self._heard = True
        if self._silent:
            self._end_silence()
        if message[1] not in self._names and message[1]:
            return None  # For another session: only messages about the connection name none.
        if message[0] in CALL_KINDS:
            return message
        return self._control(message)

    def close(self, reason: str) -> None:
        """Say goodbye to the hub, if there is one, and close; in a fork, do nothing."""
        if os.getpid() != self._process:
            return
        for session in self._welcomed:
            self._transport.send_message(Message(Kind.GOODBYE, session, 0, (clip(reason),)))
        self._transport.close(None if self._welcomed else 0)

    def _forked(self) -> LocalProtocolError:
        """Return the error of a forked child, which would take the replies of its parent."""
        return LocalProtocolError(
            f"the connection to the hub at {self._hub} is that of process {self._process}, and this is a "
            "fork of it: connect in each process"
        )

    def _end_silence(self) -> None:
        self._heard = True
        if self._silent:
            self._silent = False
            LOG.info("the hub at %s is there", self._hub)

    def _control(self, message: Message) -> Message | None:
        kind, session, _, scalars, _ = message
        if kind is Kind.HEARTBEAT:
            return None
        if kind is Kind.GOODBYE:
            # It needs no answer; an answer to a hub that has gone would only keep this socket from closing.
            self._welcomed.pop(session, None)
            raise HubClosed(one_line(str(scalars[0])))
        if kind is Kind.REFUSE:
            raise Refused(f"the hub at {self._hub} refused this {self._role}: {one_line(str(scalars[1]))}")
        if kind is Kind.ERROR and scalars[0] == ErrorCode.UNKNOWN_PEER:
            # A HELLO under way will be answered; this error is about a message sent before it.
            if self._transport.connections != self._greeted or session in self._welcomed:
                self._greet()
            return None
        if kind is Kind.WELCOME and session in self._names:
            if session in self._welcomed:
                return None  # It answers no HELLO, so nothing has to be sent again.
            self._welcome(message)
        return message

    def _greet(self) -> None:
        """Say HELLO in every session: a new connection has joined none."""
        self._welcomed.clear()
        self._greeted = self._transport.connections
        for session, (name, capabilities) in self._names.items():
            scalars = ((PROTOCOL_VERSION,), str(self._role), self._instance, name, _CODEC, capabilities)
            self.send(Message(Kind.HELLO, session, self._greeted, scalars))

    def _welcome(self, message: Message) -> None:
        scalars: Any = message.scalars
        _, _, heartbeat, timeout, max_body, *_ = scalars
        # In this order, what is no number becomes the least.
        self._heartbeat = min(60.0, max(0.01, heartbeat))
        self._timeout = max(self._heartbeat, timeout)
        self._max_body = min(max_body, MAX_BODY)
        self._transport.wait_at_most(self._heartbeat)
        self._known = True
        # A WELCOME to an earlier HELLO may come from a different hub than that of this connection.
        if message.seq == self._greeted:
            self._welcomed[message.session] = None

    def _idle(self) -> None:
        """Greet over a new connection; otherwise check the time, and send heartbeats."""
        if self._transport.connections != self._greeted:
            self._greet()
            return
        now = clock.monotonic()
        if not self._known and self._wait is not None and now - self._started >= self._wait:
            raise HubUnreachable(
                f"no hub has answered at {self._hub} for {self._wait:g} s: "
                f"start one with glue-hub or glue-experiment, or check the address",
                settings=("wait",),
            )
        heard, self._heard = self._heard, False
        if heard:
            self._received = now - self._heartbeat
        quiet = now - self._received
        if not self._silent and quiet >= (self._timeout if self._welcomed else self._heartbeat):
            self._silent = True
            LOG.warning(
                "no hub answers at %s yet; waiting for one "
                "(start glue-hub, or glue-experiment, which starts its own hub)",
                self._hub,
            )
        if self._transport.connected and not heard:  # or else the hub's next heartbeat is on its way
            for session in self._welcomed:
                self.send(Message(Kind.HEARTBEAT, session, 0))
