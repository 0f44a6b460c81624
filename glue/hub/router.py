"""The hub's end of ZeroMQ: to its peers a ROUTER socket, here plain sockets in the hub's loop.

libzmq's own ROUTER is not used: it keeps all of a message that never ends, it aborts the process when a
connection breaks in the middle of a flood (its issue 4364), and its threads double the time of a step.

A connection that holds no seat in any session does not stay for long, and a peer is read no faster than it
reads what it is told.
"""

from __future__ import annotations

import socket
from collections.abc import Callable, Sequence, Set
from functools import partial
from typing import Final

from glue.core.config import Bind, HubConfig
from glue.core.sessions import Route
from glue.errors import RemoteProtocolError
from glue.hub.connection import Connection, limit_patience, take_leave
from glue.hub.listener import Listener, OpenAddress
from glue.hub.loop import Loop
from glue.protocol import zmtp
from glue.protocol.messages import Message
from glue.protocol.wire import FROM_HUB, MAX_HEADER, encode

__all__ = ["MAX_STRANGERS", "MAX_UNFINISHED", "MAX_UNSENT", "Router"]

_BATCH: Final = 64
"""Messages of one peer that are acted on before the others get their turn."""

MAX_STRANGERS: Final = 256
"""Connections without a seat that are kept at once; one more costs the oldest its place."""

MAX_UNFINISHED: Final = 64 * 2**20
"""Bytes of messages that have not come to their end, of all peers together."""

MAX_UNSENT: Final = 64 * 2**20
"""Bytes that wait for one peer, beyond which it is out of reach: it does not read."""

_FAREWELL_SECONDS: Final = 1.0
"""How long the end of the hub is put off, at most, for the last words to be read."""


class Router:
    """Listens, and passes on what peers say.

    Args:
        loop: the loop it runs in, not yet running.
        config: times and limits.
        addresses: where peers connect; whoever opened them closes them.
        receive: takes what came: the route to answer by, the frames and the time.
        seated: the routes of all that take part in a session, as they are at any time.
        log: takes a line for people about each connection that is dropped.
    """

    def __init__(
        self,
        loop: Loop,
        config: HubConfig,
        addresses: Sequence[tuple[Bind, OpenAddress]],
        receive: Callable[[Route, list[bytes], float], None],
        seated: Set[Route],
        log: Callable[[str], None],
    ) -> None:
        self.receive = receive
        self._unfinished = 0
        self._loop = loop
        self._config = config
        self._seated = seated
        self._log = log
        self._complaint = ""
        self._dealers: dict[_Dealer, float | None] = {}
        """Everybody connected, and since when without a seat."""
        self._listeners = [
            Listener(loop, address, partial(self._accept, bind), log) for bind, address in addresses
        ]
        loop.on_tick(self._tick)

    def close(self) -> None:
        """Close, giving the last messages a moment to leave."""
        for listener in self._listeners:
            listener.stop()
        for dealer in self._dealers:
            dealer.connection.finish()
        take_leave(lambda: [dealer.connection for dealer in self._dealers], _FAREWELL_SECONDS)
        for dealer in self._dealers:
            dealer.connection.close()

    def drop(self, dealer: _Dealer, why: str | None) -> None:
        """End a connection; `why`, if it is news, completes a sentence about it."""
        # A peer with the wrong kind of socket connects again and again.
        if why is not None and why != self._complaint:
            self._complaint = why
            self._log(f"{dealer.connection.name} was dropped: {why}")
        self._unfinished -= dealer.held
        del self._dealers[dealer]
        dealer.connection.close()

    def hold(self, change: int) -> None:
        """Take note that more, or less, is kept of messages that have not come to their end.

        If it is too much, whoever sends most of it must go, those without a seat before the others.
        """
        self._unfinished += change
        while self._unfinished > MAX_UNFINISHED:
            seated = self._seated
            holders = [dealer for dealer in self._dealers if dealer.held]
            greatest = max(holders, key=lambda dealer: (dealer not in seated, dealer.held))
            self.drop(greatest, "more large messages are under way than this hub has room for")

    def _accept(self, bind: Bind, connected: socket.socket, name: str, now: float) -> None:
        self._make_room()
        limit_patience(connected, self._config.patience)
        connection = Connection(self._loop, connected, name, self._config.heartbeat)
        # What is only a little too long is read, and answered with an error that says so.
        self._dealers[_Dealer(self, connection, bind, self._config.max_body + MAX_HEADER)] = now
        connection.send(zmtp.GREETING)

    def _make_room(self) -> None:
        strangers = [dealer for dealer, since in self._dealers.items() if since is not None]
        if len(strangers) >= MAX_STRANGERS:
            strangers = [dealer for dealer in strangers if dealer not in self._seated]
        for oldest in strangers[: max(0, len(strangers) - MAX_STRANGERS + 1)]:
            self.drop(oldest, f"{MAX_STRANGERS} others without a seat are there already")

    def _tick(self, now: float) -> None:
        for dealer, since in list(self._dealers.items()):
            if dealer in self._seated:
                self._dealers[dealer] = None
            elif since is None:
                self._dealers[dealer] = now
            elif now - since >= self._config.patience:
                self.drop(dealer, None)


class _Dealer:
    """One connection, and by it whoever is at its other end; a route of the switchboard.

    Attributes:
        connection: as it is.
        held: bytes kept of what has not come to its end.
    """

    def __init__(self, router: Router, connection: Connection, bind: Bind, max_frame: int) -> None:
        self.connection = connection
        self.admits = bind.admits
        self._router = router
        self._decoder = zmtp.Decoder(max_frame)
        self.held = 0
        connection.ready = self._ready

    def deliver(self, message: Message) -> bool:
        """Pass `message` on; return False, having sent nothing, if the peer is gone or does not read."""
        connection = self.connection
        if connection.closed or connection.unsent > MAX_UNSENT:
            return False
        connection.send(zmtp.encode(encode(message, FROM_HUB)))
        return True

    def _ready(self, now: float) -> None:
        data = self.connection.receive()
        if data:
            self._decoder.receive_data(data)
        try:
            done = self._work(now)
        except RemoteProtocolError as error:
            self._router.drop(self, str(error))
            return
        if data == b"" and done:
            self._router.drop(self, None)
            return
        held = self._decoder.buffered
        if held != self.held:
            change = held - self.held
            self.held = held
            self._router.hold(change)

    def _work(self, now: float) -> bool:
        """Act on what has come, one message after the other; return whether more must come."""
        connection, decoder, receive = self.connection, self._decoder, self._router.receive
        for _ in range(_BATCH):
            if connection.unsent:
                # The turn after everything was sent comes back to this.
                connection.read(False)
                return False
            event = decoder.next_event()
            if event is None:
                connection.read(True)
                return True
            if isinstance(event, bytes):
                connection.send(event)
            else:
                receive(self, event, now)
        connection.read(False)
        connection.later()
        return False
