"""Connections of original programs that have no role: not yet, or not any more."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from glue.hub.connection import Connection, take_leave
from glue.hub.server import Hub
from glue.legacy.codec import TO_AGENT, Control, Frame, encode

__all__ = ["Lobby", "Log"]

Log = Callable[[str], None]
"""Takes a line for people."""

_MAX_GUESTS: Final = 256
"""Connections without a role that are kept at once; one more costs the oldest its place."""

_FAREWELL_SECONDS: Final = 1.0
"""How long the end of the hub is put off, at most, for programs to take their leave."""

_TERMINATE: Final = encode(Frame(Control.TERMINATE), TO_AGENT)


@dataclass(slots=True)
class _Guest:
    """A connection that may stay for a while.

    Attributes:
        expire: ends its stay, given the time.
        leaving: it is on its way out, and the hub does not end in the middle of that.
        since: when its time began to run.
    """

    expire: Callable[[float], None]
    leaving: bool
    since: float | None = None


class Lobby:
    """Where connections wait to be given a role, and take their leave. Nobody stays for long.

    Args:
        hub: a hub that does not run yet.
        log: takes a line for people about each connection that is refused, dropped or in trouble.
    """

    def __init__(self, hub: Hub, log: Log) -> None:
        self.hub = hub
        self.log = log
        self._guests: dict[Connection, _Guest] = {}
        hub.loop.on_tick(self._tick)
        hub.on_close(self._close)

    def host(self, connection: Connection, expire: Callable[[float], None], leaving: bool = False) -> None:
        """Let `connection` stay; once the hub's patience is over, call `expire` with the time."""
        self._guests[connection] = _Guest(expire, leaving)

    def release(self, connection: Connection) -> None:
        """Let `connection` go: it has a role now."""
        del self._guests[connection]

    def make_room(self, now: float) -> None:
        """See that there is room for one more."""
        if len(self._guests) >= _MAX_GUESTS:
            self._guests = {known: guest for known, guest in self._guests.items() if not known.closed}
        while len(self._guests) >= _MAX_GUESTS:
            oldest = next(iter(self._guests))
            self.log(f"{oldest.name} must go: {_MAX_GUESTS} connections without a role are there already")
            self._guests.pop(oldest).expire(now)

    def send_off(self, connection: Connection) -> None:
        """Send message 35, and hear no more of what is said."""
        connection.send(_TERMINATE)
        connection.finish()
        self.host(connection, lambda now: connection.close(), leaving=True)

    def _tick(self, now: float) -> None:
        for connection, guest in list(self._guests.items()):
            if guest.since is None:
                guest.since = now
            if connection.closed:
                del self._guests[connection]
            elif now - guest.since >= self.hub.config.patience:
                del self._guests[connection]
                guest.expire(now)

    def _close(self) -> None:
        """Wait a moment for those on their way out: their last words should meet an open connection."""
        take_leave(
            lambda: [known for known, guest in self._guests.items() if guest.leaving], _FAREWELL_SECONDS
        )
        now = time.monotonic()
        for connection, guest in list(self._guests.items()):
            if not connection.closed:
                guest.expire(now)
                connection.close()
