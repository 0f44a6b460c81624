"""The loop that a hub runs in: one thread that waits for descriptors and for time to pass.

Nothing called from it may wait for anything itself.
"""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Callable
from typing import Final

__all__ = ["FAILURE", "READ", "WRITE", "Loop"]

READ: Final = select.POLLIN
WRITE: Final = select.POLLOUT
FAILURE: Final = 0
"""What is watched for neither is still told of its failures."""


class Loop:
    """Calls whoever waits for a descriptor, and, every so often, whoever waits for time to pass.

    Args:
        every: seconds between ticks.

    Attributes:
        stopping: why it ends or has ended; None as long as it goes on.
    """

    def __init__(self, every: float) -> None:
        self.stopping: str | None = None
        self._every = every
        self._poller = select.poll()
        self._ready: dict[int, Callable[[float], None]] = {}
        self._tickers: list[Callable[[float], None]] = []
        self._wake, self._waker = socket.socketpair()
        self._wake.setblocking(False)
        self._waker.setblocking(False)
        self.watch(self._wake.fileno(), READ, lambda now: None)

    def watch(self, fd: int, events: int, ready: Callable[[float], None]) -> None:
        """Call `ready` with the time whenever `fd` is, or has failed; `events` are READ and WRITE."""
        self._ready[fd] = ready
        self._poller.register(fd, events)

    def unwatch(self, fd: int) -> None:
        """Undo `watch`."""
        del self._ready[fd]
        self._poller.unregister(fd)

    def on_tick(self, tick: Callable[[float], None]) -> None:
        """Call `tick` with the time at every tick, in the order in which this was asked. Before `run`."""
        self._tickers.append(tick)

    def run(self) -> None:
        """Wait and call, until `stop`."""
        poll, waiting, clock = self._poller.poll, self._ready, time.monotonic
        tick_at = clock() + self._every
        while self.stopping is None:
            events = poll(max(0, int((tick_at - clock()) * 1000) + 1))
            now = clock()
            for fd, _ in events:
                # Whoever was called before it may have ended the wait for it.
                ready = waiting.get(fd)
                if ready is not None:
                    ready(now)
            if now >= tick_at:
                for tick in self._tickers:
                    tick(now)
                tick_at = now + self._every

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
