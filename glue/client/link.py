"""A peer's connection to a hub: greetings, heartbeats, and reconnecting after a break."""

from __future__ import annotations

import os
import platform
import time
from collections.abc import Callable, Mapping
from typing import Final

import zmq

from glue.client.transport import Context, DealerTransport
from glue.core.config import check_session, check_url
from glue.core.sessions import INSTANCE_SIZE
from glue.errors import HubClosed, LocalProtocolError, Refused
from glue.protocol.messages import CALLS, PROTOCOL_VERSION, ErrorCode, Kind, Message, Role
from glue.protocol.wire import FROM_HUB, MAX_BODY, MAX_HEADER, TO_HUB, UnknownKind, clip, decode, encode

__all__ = ["Link", "Log"]

Log = Callable[[str], None]

_CODEC: Final = f"Python {platform.python_version()}"
_HEARTBEAT: Final = 1.0
_PATIENCE: Final = 5.0


class Link:
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
            # It has no answer; one to a hub that has gone would only keep this socket from closing.
            self._welcomed.discard(session)
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
