"""The loop that a hub runs in: one thread that waits for descriptors and for time to pass.

Nothing called from it may wait for anything itself.

Work that nobody asked for, such as accepting connections or reading what was sent out of turn, goes through
a queue. One piece of it is done in each turn of the loop, and all of it together takes at most a fifth of the
time: however many peers flood the hub, a session that plays has the rest.
"""

from __future__ import annotations

import select
import socket
import time
from collections import deque
from collections.abc import Callable
from typing import Final

__all__ = ["FAILURE", "READ", "WRITE", "Loop"]

READ: Final = select.POLLIN
WRITE: Final = select.POLLOUT
FAILURE: Final = 0
"""Descriptors with no registered interest still report errors."""

_SHARE: Final = 0.2
"""Of the time, for the queue."""

_MOST_SAVED: Final = 0.02
"""Seconds of the queue's share that can be saved up while it is empty."""

Work = Callable[[float], None]
"""Takes the time, as `time.monotonic` returns it."""


class Loop:
    """Calls functions when a descriptor is ready, when time has passed, and when the queue has its turn.

    Args:
        every: seconds between ticks.
        log: takes a line for people, about errors that cost a connection.

    Attributes:
        log: as given.
        stopping: why it ends or has ended; None as long as it goes on.
    """

    def __init__(self, every: float, log: Callable[[str], None]) -> None:
        self.log = log
        self.stopping: str | None = None
        self._every = every
        self._tick_at = time.monotonic() + every
        self._poller = select.poll()
        self._ready: dict[int, Work] = {}
        self._tickers: list[Work] = []
        self._queue: deque[Work] = deque()
        self._saved = _MOST_SAVED
        self._saved_at = 0.0
        self._wake, self._waker = socket.socketpair()
        self._wake.setblocking(False)
        self._waker.setblocking(False)
        self.watch(self._wake.fileno(), READ, lambda now: None)

    def watch(self, fd: int, events: int, ready: Work) -> None:
        """Call `ready` whenever `fd` is ready or has failed; `events` are READ and WRITE."""
        self._ready[fd] = ready
        self._poller.register(fd, events)

    def unwatch(self, fd: int) -> None:
        """Undo `watch`, if it was called."""
        if self._ready.pop(fd, None) is not None:
            self._poller.unregister(fd)

    def queue(self, work: Work) -> None:
        """Call `work` once, after all that was queued before, as the queue's share of the time allows."""
        self._queue.append(work)

    def on_tick(self, tick: Work) -> None:
        """Call `tick` at every tick; several are called in the order in which they were given."""
        self._tickers.append(tick)

    def run(self) -> None:
        """Take turns until `stop`."""
        while self.stopping is None:
            self.turn()

    def turn(self) -> None:
        """Wait until there is something to do, and do it: what is ready, one piece of the queue, a tick."""
        ready = self._ready
        wait = self._tick_at - time.monotonic()
        if self._queue:
            wait = min(wait, -self._saved / _SHARE)
        events = self._poller.poll(int(wait * 1000) + 1 if wait > 0 else 0)
        now = time.monotonic()
        for fd, _ in events:
            # What was called before it may have ended the wait for it.
            work = ready.get(fd)
            if work is not None:
                work(now)
        if self._queue:
            self._work_off()
        if now >= self._tick_at:
            for tick in self._tickers:
                tick(now)
            self._tick_at = now + self._every

    def _work_off(self) -> None:
        now = time.monotonic()
        self._saved = min(_MOST_SAVED, self._saved + (now - self._saved_at) * _SHARE)
        self._saved_at = now
        if self._saved > 0:
            self._queue.popleft()(now)
            self._saved -= time.monotonic() - now

    def stop(self, reason: str) -> None:
        """Let `run` end; may be called from any thread or signal handler."""
        self.stopping = self.stopping or reason
        try:
            self._waker.send(b"\0")
        except OSError:
            # Full or closed: the loop is awake or over.
            return

    def close(self) -> None:
        """Close what the loop itself holds."""
        self._wake.close()
        self._waker.close()
