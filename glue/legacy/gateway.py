"""Original RL-Glue programs as peers of the hub: listeners in the hub's own loop.

To a session an original program is a peer like any other. What it sends becomes messages for the
switchboard, and what the switchboard has for it becomes frames, one at a time:

- A player, that is an agent or environment, is sent a call only after it has answered the one before,
  even if nobody waits for that answer any more: a Java program loses what comes with something else.
- An experiment's next request is taken up only after the reply to the one before has been sent.
- A player takes part in one run, as originals do. It is sent off with message 35, on which it ends:
  when the experiment leaves, when the hub ends, when its role is taken, and when it breaks the
  protocol. A bare end of connection would make C programs run wild and Python ones hang.
- An experiment cannot be told that a call failed. If a player was lost, and the call can be made from
  its beginning with another, it is made again. If not, the connection is reset: after a mere end of
  connection C programs would go on with old numbers, and Python ones hang.

Source: RL-Glue core 3.04, RL_network_glue.c; rl-glue-ext, the C, Java and Python codecs.
"""

from __future__ import annotations

import errno
import os
import socket
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from typing import Final

from glue.core.config import LegacyPort
from glue.errors import ConfigError, RemoteProtocolError
from glue.hub.connection import Connection
from glue.hub.listener import Listener, OpenAddress, open_port
from glue.hub.server import Hub
from glue.legacy.codec import (
    FROM_AGENT,
    FROM_ENVIRONMENT,
    FROM_EXPERIMENT,
    FROM_STRANGER,
    Control,
    Decoder,
    Vocabulary,
)
from glue.legacy.lobby import Lobby, Log
from glue.legacy.peers import Experiment, Player
from glue.protocol.messages import Kind, Role

__all__ = ["Gateway", "open_legacy_port"]

_ROLES: Final[Mapping[Kind | Control, Role]] = {
    Control.CONNECT_AGENT: Role.AGENT,
    Control.CONNECT_ENVIRONMENT: Role.ENVIRONMENT,
    Control.CONNECT_EXPERIMENT: Role.EXPERIMENT,
}
_FROM: Final[Mapping[Role, Vocabulary]] = {
    Role.AGENT: FROM_AGENT,
    Role.ENVIRONMENT: FROM_ENVIRONMENT,
    Role.EXPERIMENT: FROM_EXPERIMENT,
}


_NONE: Final[Mapping[LegacyPort, OpenAddress]] = {}


class Gateway:
    """Lets original programs into the sessions of `hub`, from the moment it is made until the hub ends.

    Args:
        hub: a hub that does not run yet.
        ports: where to listen, and which session is joined there.
        log: takes a line for people about each connection that is refused, dropped or in trouble.
        opened: those of `ports` that are open already, see `open_legacy_port`; they stay open when the hub
            closes.

    Attributes:
        ports: the same, free ports resolved.

    Raises:
        ConfigError: an address is taken, or cannot be listened on.
    """

    def __init__(
        self,
        hub: Hub,
        ports: Sequence[LegacyPort],
        log: Log = lambda line: None,
        opened: Mapping[LegacyPort, OpenAddress] = _NONE,
    ) -> None:
        self.ports: list[LegacyPort] = []
        self._listeners: list[Listener] = []
        self._lobby = Lobby(hub, log)
        with ExitStack() as closing:
            addresses = [
                (port, opened.get(port) or closing.enter_context(open_legacy_port(port))) for port in ports
            ]
            self._addresses = closing.pop_all()
        for port, address in addresses:
            self._listen(port, address)
        hub.on_close(self._stop_listening)

    def _listen(self, port: LegacyPort, address: OpenAddress) -> None:
        lobby, loop, heartbeat = self._lobby, self._lobby.hub.loop, self._lobby.hub.config.heartbeat

        def accept(connected: socket.socket, name: str, now: float) -> None:
            lobby.make_room(now)
            _Stranger(lobby, Connection(loop, connected, name, heartbeat), port)

        self._listeners.append(Listener(loop, address, accept, lobby.log))
        self.ports.append(replace(port, port=address.port))

    def _stop_listening(self) -> None:
        for listener in self._listeners:
            listener.stop()
        self._addresses.close()


def open_legacy_port(port: LegacyPort) -> OpenAddress:
    """Listen on a port for original programs.

    Raises:
        ConfigError: it is in use, or its host is not one of this machine.
    """
    try:
        return open_port(port.host, port.port)
    except OSError as error:
        raise ConfigError(_cannot_listen(port, error)) from None


def _cannot_listen(port: LegacyPort, error: OSError) -> str:
    if error.errno == errno.EADDRINUSE:
        return (
            f"cannot listen for original RL-Glue programs on {port}: the port is in use; is the rl_glue "
            f"server or another hub running? Stop it, or choose another port with --legacy-port"
        )
    # Python adds the address to the text of the system's own errors; those of names are negative.
    number = error.errno or 0
    reason = os.strerror(number) if number > 0 else error.strerror
    return f"cannot listen for original RL-Glue programs on {port}: {reason}"


class _Stranger:
    """A connection that has not said what it is."""

    def __init__(self, lobby: Lobby, connection: Connection, port: LegacyPort) -> None:
        self._lobby = lobby
        self._connection = connection
        self._port = port
        self._decoder = Decoder(FROM_STRANGER)
        connection.ready = self._ready
        lobby.host(connection, self._expire)

    def _ready(self, now: float) -> None:
        connection, decoder = self._connection, self._decoder
        data = connection.receive()
        if data is None:
            return
        if not data:
            # A port probe.
            connection.close()
            return
        decoder.receive_data(data)
        try:
            hello = decoder.next_event()
        except RemoteProtocolError as error:
            self._lobby.log(f"{connection.name} is no RL-Glue program: {error}")
            connection.close()
            return
        if hello is not None:
            self._lobby.release(connection)
            role = _ROLES[hello.kind]
            decoder.expect(_FROM[role])
            made = Experiment if role is Role.EXPERIMENT else Player
            made(self._lobby, connection, decoder, role, self._port).join(now)

    def _expire(self, now: float) -> None:
        self._lobby.log(f"{self._connection.name} has not said what it is; it is dropped")
        self._connection.close()
