"""Connections of original programs that have no role: not yet, or not any more."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from glue.hub.connection import Connection, take_leave
from glue.hub.log import Log
from glue.hub.server import Hub
from glue.legacy.codec import TO_AGENT, Control, Frame, encode

__all__ = ["MAX_PENDING", "Pending"]

MAX_PENDING: Final = 256
"""Connections without a role that are kept at once; one more makes the oldest close."""

_CLOSING_SECONDS: Final = 1.0
"""How long the end of the hub is delayed, at most, for programs to finish and close."""

_SUMMARY_SECONDS: Final = 60.0
"""How often the connections that were dropped are summed up in the log."""

_TERMINATE: Final = encode(Frame(Control.TERMINATE), TO_AGENT)


@dataclass(slots=True)
class _Entry:
    """A connection without a role.

    Attributes:
        time_out: ends it, given the time.
        closing: a program is about to end; the hub waits for it a moment.
        since: when its timeout began.
    """

    time_out: Callable[[float], None]
    closing: bool
    since: float | None = None


class Pending:
    """The connections without a role, each with a timeout.

    Args:
        hub: a hub that does not run yet.
        log: takes a line for people about each connection that is refused, dropped or in trouble.
    """

    def __init__(self, hub: Hub, log: Log) -> None:
        self.hub = hub
        self.log = log
        self._entries: dict[Connection, _Entry] = {}
        self._weighing: list[Callable[[], bool]] = []
        self._dropped = _DroppedLog(log)
        hub.loop.on_tick(self._tick)
        hub.on_close(self._close)

    def add(self, connection: Connection, time_out: Callable[[float], None], closing: bool = False) -> None:
        """Keep `connection`; after the hub's timeout, call `time_out` with the time."""
        self._entries[connection] = _Entry(time_out, closing)

    def on_tick(self, weigh: Callable[[], bool]) -> None:
        """Call `weigh` at every tick until it returns False: its connection has closed."""
        self._weighing.append(weigh)

    def remove(self, connection: Connection) -> None:
        """Forget `connection`, which has a role now."""
        del self._entries[connection]

    def make_room(self, now: float) -> None:
        """Make room for one more connection, at the expense of the oldest."""
        if len(self._entries) >= MAX_PENDING:
            self._entries = {known: entry for known, entry in self._entries.items() if not known.closed}
        while len(self._entries) >= MAX_PENDING:
            oldest = next(iter(self._entries))
            entry = self._entries.pop(oldest)
            if entry.closing:
                entry.time_out(now)
            else:
                self.drop(oldest, f"{MAX_PENDING} newer connections have no role either", "", now)

    def drop(self, connection: Connection, reason: str, details: str, now: float) -> None:
        """Close `connection` and log why; lines with the same `reason` are summed up."""
        self._dropped.add(connection, reason, details, now)
        connection.close()

    def terminate(self, connection: Connection) -> None:
        """Send message 35, on which original programs end, and ignore what is received after it."""
        connection.send(_TERMINATE)
        connection.finish()
        self.add(connection, lambda now: connection.close(), closing=True)

    def _tick(self, now: float) -> None:
        for connection, entry in list(self._entries.items()):
            if entry.since is None:
                entry.since = now
            if connection.closed:
                del self._entries[connection]
            elif now - entry.since >= self.hub.config.timeout:
                del self._entries[connection]
                entry.time_out(now)
        self._weighing = [weigh for weigh in self._weighing if weigh()]
        self._dropped.tick(now)

    def _close(self) -> None:
        """Give programs that are about to end a moment: their last answer should find an open connection."""
        take_leave(
            lambda: [known for known, entry in self._entries.items() if entry.closing], _CLOSING_SECONDS
        )
        now = time.monotonic()
        for connection, entry in list(self._entries.items()):
            if not connection.closed:
                if entry.closing:
                    entry.time_out(now)
                connection.close()
        self._dropped.close()


class _DroppedLog:
    """Lines about dropped connections: for each reason the first one in full, and then a sum now and then.

    A crowd of connections, or one that comes back again and again, would fill the log otherwise.
    """

    def __init__(self, log: Log) -> None:
        self._log = log
        self._logged_at: dict[str, float] = {}
        self._counts: dict[str, int] = {}

    def add(self, connection: Connection, reason: str, details: str, now: float) -> None:
        if reason in self._logged_at:
            self._counts[reason] = self._counts.get(reason, 0) + 1
        else:
            self._logged_at[reason] = now
            self._log(f"{connection.name} was dropped: {reason}{details}")

    def tick(self, now: float) -> None:
        for reason, logged_at in list(self._logged_at.items()):
            if now - logged_at >= _SUMMARY_SECONDS:
                del self._logged_at[reason]
                if reason in self._counts:
                    self._logged_at[reason] = now
                    self._sum_up(reason)

    def close(self) -> None:
        for reason in list(self._counts):
            self._sum_up(reason)

    def _sum_up(self, reason: str) -> None:
        count = self._counts.pop(reason)
        self._log(f"{count} more {'connection was' if count == 1 else 'connections were'} dropped: {reason}")
