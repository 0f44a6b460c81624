"""The hub's end of ZeroMQ: to its peers a ROUTER socket, here plain sockets in the hub's loop.

libzmq's own ROUTER is not used: it keeps all of a message that never ends, it aborts the process when a
connection breaks in the middle of a flood (its issue 4364), and its threads double the time of a step.

A connection has to take a seat in a session soon after it is made. In a turn of the loop, one message is read
from it for each of its seats: so sessions share the hub fairly. If what it sent was out of turn, its next
message waits in the loop's queue. A peer is read no faster than it reads what it is sent
(`glue.hub.dealer`).
"""

from __future__ import annotations

import socket
from collections.abc import Callable, Sequence
from functools import partial
from typing import Final

from glue.core.config import Bind, HubConfig
from glue.core.keys import Keys
from glue.core.memory import Memory
from glue.core.peer import Route
from glue.hub.connection import Connection, take_leave
from glue.hub.dealer import Dealer, KeyedDealer
from glue.hub.listener import Listener, OpenAddress
from glue.hub.log import Log
from glue.hub.loop import Loop
from glue.protocol import zmtp
from glue.protocol.steps import Step, StepFormat
from glue.sockets.options import limit_silence

__all__ = ["GREETING_SECONDS", "MAX_UNSEATED", "Router"]

MAX_UNSEATED: Final = 256
"""Maximum number of connections without a seat; when there is one more, the oldest is dropped."""

GREETING_SECONDS: Final = 1.0
"""How long a connection may be without a seat before it is dropped, at the next tick."""

_FAREWELL_SECONDS: Final = 1.0
"""Seconds that the hub waits at most, when it closes, for its last messages to be read."""


class Router:
    """Listens, and passes on what peers send.

    Args:
        loop: the loop it runs in, not yet running.
        config: times and limits.
        addresses: where peers connect; closed by the caller.
        receive: takes the route to answer by, the frames received and the time; returns whether the message
            was in turn. RemoteProtocolError ends the connection.
        receive_step: takes the route, the format, the answer to a step and the time; returns whether it
            answers the step that is outstanding.
        lose: takes the route of a connection that was dropped by the hub, why, and the time.
        num_seats: returns in how many sessions a route takes part.
        memory: accounts for what is kept of messages that are not complete, and of those not yet read.
        log: takes a line for people about each connection that is dropped.
    """

    def __init__(
        self,
        loop: Loop,
        config: HubConfig,
        addresses: Sequence[tuple[Bind, OpenAddress]],
        receive: Callable[[Route, Sequence[bytes], float], bool],
        receive_step: Callable[[Route, StepFormat, Step, float], bool],
        lose: Callable[[Route, str, float], None],
        num_seats: Callable[[Route], int],
        memory: Memory,
        log: Log,
    ) -> None:
        self.receive = receive
        self.receive_step = receive_step
        self.expect = loop.expect
        self.lose = lose
        self.memory = memory
        self._loop = loop
        self._config = config
        self.num_seats = num_seats
        self._log = log
        self._complaint = ""
        self._keys: Keys | None = None  # that have replaced those of the addresses
        self._dealers: set[Dealer] = set()
        self.joined: dict[Dealer, list[bytes]] | None = None
        """Steps to be sent together, while the answers that they follow from are acted on."""
        self._unseated: dict[Dealer, float] = {}
        """Those without a seat, the oldest first, and since when."""
        self._listeners = [
            Listener(loop, address, partial(self._accept, bind), log) for bind, address in addresses
        ]
        loop.on_tick(self._tick)

    def close(self) -> None:
        """Close, after a moment for the last messages to be read."""
        for listener in self._listeners:
            listener.stop()
        for dealer in self._dealers:
            dealer.connection.finish()
        take_leave(lambda: [dealer.connection for dealer in self._dealers], _FAREWELL_SECONDS)
        for dealer in self._dealers:
            dealer.connection.close()

    def renew(self, keys: Keys, now: float) -> None:
        """Replace the keys of every address that has any; drop connections whose admission has changed."""
        self._keys = keys
        for dealer in list(self._dealers):
            if isinstance(dealer, KeyedDealer) and (why := dealer.renew(keys)):
                self.drop(dealer, why)
                self.lose(dealer, f"was dropped: {why}", now)

    def drop(self, dealer: Dealer, why: str | None) -> None:
        """Close a connection; `why`, if it should be logged, completes a sentence about it."""
        if why is not None:
            self.complain(dealer, why)
        self.memory.hold(dealer, 0)
        self._dealers.discard(dealer)
        self._unseated.pop(dealer, None)
        dealer.connection.close()
        self._log.connection(f"{dealer.connection.name} is gone")

    def complain(self, dealer: Dealer, why: str) -> None:
        """Log why a connection is dropped, unless the reason is the same as the last time."""
        # A peer with the wrong kind of socket connects again and again.
        if why != self._complaint:
            self._complaint = why
            self._log(f"{dealer.connection.name} was dropped: {why}")

    def _accept(self, bind: Bind, connected: socket.socket, name: str, now: float) -> None:
        self._make_room()
        limit_silence(connected, self._config.timeout)
        connection = Connection(self._loop, connected, name, self._config.heartbeat)
        if bind.keys is None:
            dealer = Dealer(self, connection, bind, self._config.max_body)
            connection.send(zmtp.GREETING)
        else:
            dealer = KeyedDealer(self, connection, bind, self._config.max_body, self._keys or bind.keys)
            connection.send(zmtp.CURVE_GREETING)
        self._dealers.add(dealer)
        self._unseated[dealer] = now
        self._log.connection(f"{name} connected")

    def seated(self, dealer: Dealer) -> None:
        """Note that a connection has a seat."""
        self._unseated.pop(dealer, None)

    def _make_room(self) -> None:
        while len(self._unseated) >= MAX_UNSEATED:
            oldest = next(iter(self._unseated))
            self.drop(oldest, f"{MAX_UNSEATED} newer connections have not joined a session either")

    def _tick(self, now: float) -> None:
        for dealer in list(self._dealers):
            if self.num_seats(dealer):
                self.seated(dealer)
            elif now - self._unseated.setdefault(dealer, now) >= GREETING_SECONDS:
                self.drop(dealer, None)
