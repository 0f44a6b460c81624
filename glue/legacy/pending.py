"""Connections of original programs that have no role yet, or no longer have one."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from glue.hub.io.connection import Connection, take_leave
from glue.hub.io.log import Log
from glue.hub.io.server import Hub
from glue.legacy.codec import TO, Control, Frame, encode
from glue.system import clock
from glue.wire.messages import Role

MAX_PENDING: Final = 256
"""Maximum number of connections without a role; one more closes the oldest."""

_SUMMARY_SECONDS: Final = 60.0
"""Interval in seconds at which dropped connections are summed up in the log."""

_TERMINATE: Final = encode(Frame(Control.TERMINATE), TO[Role.AGENT])


@dataclass(slots=True)
class _Entry:
    """A connection without a role.

    Attributes:
        time_out: closes the connection; called with the time.
        closing: the program is about to exit; the hub waits for it briefly.
        since: the time at which its timeout began, in seconds; None before.
    """

    time_out: Callable[[float], None]
    closing: bool
    since: float | None = None


class Pending:
    """The connections without a role, each with a timeout.

    Args:
        hub: a hub that does not run yet.
        log: called with a line about each connection that is refused, dropped or has an error.
    """

    def __init__(self, hub: Hub, log: Log) -> None:
        self.hub = hub
        self.log = log
        self._entries: dict[Connection, _Entry] = {}
        self._accounting: list[Callable[[], bool]] = []
        self._dropped = _DroppedLog(log)
        hub.loop.on_tick(self._tick)
        hub.on_close(self._close)

    def add(self, connection: Connection, time_out: Callable[[float], None], closing: bool = False) -> None:
        """Keep `connection`; after the hub's timeout, call `time_out` with the time."""
        self._entries[connection] = _Entry(time_out, closing)

    def on_tick(self, account: Callable[[], bool]) -> None:
        """Call `account` at every tick until it returns False, which means that its connection has closed."""
        self._accounting.append(account)

    def remove(self, connection: Connection) -> None:
        """Remove `connection`, which has a role now."""
        del self._entries[connection]

    def make_room(self, now: float) -> None:
        """Make room for one more connection; close the oldest if there are too many."""
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
        """Send message 35, on which original programs exit, and ignore later data."""
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
        self._accounting = [account for account in self._accounting if account()]
        self._dropped.tick(now)

    def _close(self) -> None:
        """Close all; wait briefly for programs about to exit, whose last answer needs an open connection."""
        take_leave(
            lambda: [known for known, entry in self._entries.items() if entry.closing],
            self.hub.config.farewell,
        )
        now = clock.monotonic()
        for connection, entry in list(self._entries.items()):
            if not connection.closed:
                if entry.closing:
                    entry.time_out(now)
                connection.close()
        self._dropped.close()


class _DroppedLog:
    """Log of dropped connections: for each reason the first one in full, then a count at intervals.

    Otherwise many connections, or one that reconnects repeatedly, would fill the log.
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
