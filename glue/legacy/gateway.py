"""Original RL-Glue programs as peers of the hub: listeners in the hub's own loop.

To a session an original program is a peer like any other. Its frames are translated into messages to the
sessions, and the sessions's messages are translated into frames, one at a time:

- A player, that is an agent or environment, is sent a call only after it has answered the previous one, even
  if that answer is no longer needed: a Java program loses a frame that arrives together with another.
- An experiment's next request is started only after the reply to the previous one has been sent. If it sends
  several requests ahead and closes its sending half, it still gets their replies.
- A player takes part in one run, as the originals do. It is sent message 35, on which it exits, when the
  experiment leaves, when the hub closes, when its role is taken, and when it violates the protocol. If the
  connection were merely closed, C programs would continue with stale data and Python programs would hang.
- The protocol cannot report a failed call to an experiment. If a player was lost, and the call can be
  repeated from its beginning with another player, it is. If not, the connection is reset: if it were merely
  closed, C programs would continue with stale data, and Python programs would hang.

The first rule, and the consequences of a lost player, are the tables of `glue.legacy.states`.

Source: RL-Glue core 3.04, RL_network_glue.c; rl-glue-ext, the C, Java and Python codecs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from functools import partial
from typing import Final

from glue.errors import RemoteProtocolError
from glue.hub.config import LegacyPort
from glue.hub.io.connection import Connection, Owner
from glue.hub.io.listener import Listener, OpenAddress, open_address
from glue.hub.io.log import Log
from glue.hub.io.server import Hub
from glue.legacy.codec import FROM, HANDSHAKE, Decoder
from glue.legacy.experiment import LegacyExperiment
from glue.legacy.peers import LegacyPlayer
from glue.legacy.pending import Pending
from glue.system import network
from glue.wire.messages import Role

_NONE: Final[Mapping[LegacyPort, OpenAddress]] = {}


class Gateway:
    """Listeners that admit original programs to the sessions of a hub, from construction until it closes.

    Args:
        hub: a hub that does not run yet.
        ports: the ports to listen on, with their sessions.
        log: called with a line about each connection that is refused, dropped or has an error, in a separate
            thread, so that the hub does not wait for it. Or a `Log`, which its owner closes.
        opened: the `ports` that are already open, see `open_legacy_port`; they stay open when the hub closes.

    Attributes:
        ports: the same ports, with the numbers of free ports resolved.

    Raises:
        ConfigError: an address is in use, or cannot be listened on.
    """

    def __init__(
        self,
        hub: Hub,
        ports: Sequence[LegacyPort],
        log: Callable[[str], None] | Log = lambda line: None,
        opened: Mapping[LegacyPort, OpenAddress] = _NONE,
    ) -> None:
        self.ports: list[LegacyPort] = []
        self._listeners: list[Listener] = []
        lines = log if isinstance(log, Log) else Log(log)
        self._pending = Pending(hub, lines)
        with ExitStack() as closing:
            addresses = [
                (port, opened.get(port) or closing.enter_context(open_legacy_port(port))) for port in ports
            ]
            self._addresses = closing.pop_all()
        for port, address in addresses:
            self._listen(port, address)
        hub.on_close(self._stop_listening)
        if lines is not log:
            hub.on_close(partial(lines.close, hub.config.farewell))

    def _listen(self, port: LegacyPort, address: OpenAddress) -> None:
        pending, hub = self._pending, self._pending.hub

        def accept(connected: network.socket, name: str, now: float) -> None:
            pending.make_room(now)
            _Handshake(pending, Connection(hub.loop, connected, name, hub.config.heartbeat), port)

        self._listeners.append(Listener(hub.loop, address, accept, pending.log))
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
    host = f"[{port.host}]" if ":" in port.host else port.host
    return open_address(f"tcp://{host}:{port.port or '*'}", "legacy_port")


class _Handshake(Owner):
    """A connection that has not stated its role yet."""

    def __init__(self, pending: Pending, connection: Connection, port: LegacyPort) -> None:
        self._pending = pending
        self._connection = connection
        self._port = port
        self._decoder = Decoder(HANDSHAKE, pending.hub.config.max_body)
        connection.owner = self
        pending.add(connection, self._time_out)

    def ready(self, now: float) -> None:
        """Handle received data."""
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
            frame = decoder.next_event()
        except RemoteProtocolError as error:
            self._pending.drop(connection, "it is not an RL-Glue program", f": {error}", now)
            return
        if frame is not None:
            self._pending.remove(connection)
            role = Role[frame.kind.name.removeprefix("CONNECT_")]
            decoder.expect(FROM[role])
            peer = LegacyExperiment if role is Role.EXPERIMENT else LegacyPlayer
            peer(self._pending, connection, decoder, role, self._port).join(now)

    def _time_out(self, now: float) -> None:
        self._pending.drop(self._connection, "it did not say which role it is to have", "", now)
