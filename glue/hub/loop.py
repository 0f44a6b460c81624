"""The loop that a hub runs in: one thread that waits for descriptors and for time to pass.

Nothing called from it may wait for anything itself.

Unsolicited work, such as accepting connections or reading what was sent out of turn, goes through a
queue. One piece of it is done in each turn of the loop, and all of it together takes at most a fifth of the
time: however many peers flood the hub, a session that plays has the rest.
"""

from __future__ import annotations

import math
import select
import socket
import threading
import time
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from typing import Final

from glue.sockets.looking import LONG_LOOK_SECONDS, SEVERAL_CORES, give_way

__all__ = ["FAILURE", "READ", "WRITE", "Loop"]

READ: Final = select.POLLIN
WRITE: Final = select.POLLOUT
FAILURE: Final = 0
"""Descriptors with no registered interest still report errors."""

_SHARE: Final = 0.2
"""Of the time, for the queue."""

_MAX_SAVED: Final = 0.02
"""Seconds of the queue's share that can be saved up while it is empty."""

_LOOK_SECONDS: Final = 50e-6
"""How long an expected answer is looked for before the loop sleeps: fast players answer within it."""

_MAX_MISSES: Final = 8
"""After n unsuccessful looks in succession, the next 2**n waits do without one; this is the maximum of n."""

_GRACE_SECONDS: Final = 0.05
"""How long the thread in `run` waits for another to take the loop again, before it goes on itself."""

_WAKE_SIZE: Final = 4096

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
        mutex: held by the thread that takes a turn. Other threads than the one in `run` call `ask` and then
            take turns in `with loop.mutex:`. No other form is safe from Ctrl-C, which may be raised after any
            call, also after one that has acquired a lock.
    """

    def __init__(self, every: float, log: Callable[[str], None]) -> None:
        self.log = log
        self.stopping: str | None = None
        self._every = every
        self._tick_at = time.monotonic() + every
        self._poller = select.epoll() if hasattr(select, "epoll") else _Poll()
        self._ready: dict[int, Work] = {}
        self._tickers: list[Work] = []
        self._queue: deque[Work] = deque()
        self._saved = _MAX_SAVED
        self._saved_at = 0.0
        self._expecting = False
        self._look_seconds = _LOOK_SECONDS
        self._misses = 0
        self._without_look = 0
        self.mutex = threading.Lock()
        self._times_asked = 0
        self._wake, self._waker = socket.socketpair()
        self._wake.setblocking(False)
        self._waker.setblocking(False)
        self.watch(self._wake.fileno(), READ, self._woken)

    def watch(self, fd: int, events: int, ready: Work) -> None:
        """Call `ready` whenever `fd` is ready or has failed; `events` are READ and WRITE."""
        if fd in self._ready:
            self._poller.modify(fd, events)
        else:
            self._poller.register(fd, events)
        self._ready[fd] = ready

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

    def expect(self) -> None:
        """Note that a peer was sent what it usually answers at once."""
        self._expecting = SEVERAL_CORES

    def look_longer(self) -> None:
        """Note that a peer has joined that is many games, or acts in many: its answers take longer."""
        self._look_seconds = LONG_LOOK_SECONDS

    def run(self) -> None:
        """Take turns until `stop`, but for the time in which other threads take the loop."""
        times_asked = 0
        while self.stopping is None:
            taken = self.mutex.locked()
            with self.mutex:
                asked, times_asked = self._times_asked != times_asked, self._times_asked
                if not (taken or asked):
                    self.turn()
            if taken or asked:
                time.sleep(_GRACE_SECONDS)

    def ask(self) -> None:
        """Let the thread in `run` release `mutex`; it then waits a moment: to ask again soon is cheap."""
        self._times_asked += 1
        if self.mutex.locked():
            self._wake_up()

    def turn(self, seconds: float = math.inf) -> None:
        """Wait up to `seconds` until there is something to do, and do it.

        That is what is ready, one piece of the queue, and a tick.
        """
        ready = self._ready
        events = self._look() if self._expecting else None
        now = time.monotonic()
        if not events:
            wait = min(seconds, self._tick_at - now)
            if self._queue:
                wait = min(wait, -self._saved / _SHARE)
            events = self._poller.poll(max(wait, 0))
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

    def _look(self) -> list[tuple[int, int]] | None:
        """Return events, if there are any within a moment.

        Falling asleep and being woken takes longer than most answers, so an expected one is first polled for.
        """
        self._expecting = False
        if self._without_look:
            self._without_look -= 1
            return None
        poll, clock = self._poller.poll, time.monotonic
        until = clock() + self._look_seconds
        while True:
            events = poll(0)
            if events:
                self._misses = 0
                return events
            if clock() >= until:
                break
            if self._look_seconds > _LOOK_SECONDS:
                give_way()
        self._misses = min(self._misses + 1, _MAX_MISSES)
        self._without_look = 2**self._misses
        return None

    def _work_off(self) -> None:
        now = time.monotonic()
        self._saved = min(_MAX_SAVED, self._saved + (now - self._saved_at) * _SHARE)
        self._saved_at = now
        if self._saved > 0:
            self._queue.popleft()(now)
            self._saved -= time.monotonic() - now

    def stop(self, reason: str) -> None:
        """Let `run` end; may be called from any thread or signal handler."""
        self.stopping = self.stopping or reason
        self._wake_up()

    def _wake_up(self) -> None:
        with suppress(OSError):  # full or closed: the loop is awake or over
            self._waker.send(b"\0")

    def _woken(self, now: float) -> None:
        self._wake.recv(_WAKE_SIZE)

    def close(self) -> None:
        """Close what the loop itself holds."""
        self._wake.close()
        self._waker.close()
        self._poller.close()


class _Poll:
    """`select.poll` in the form of `select.epoll`, for systems that have none."""

    def __init__(self) -> None:
        self._poller = select.poll()
        self.register = self._poller.register
        self.modify = self._poller.modify
        self.unregister = self._poller.unregister

    def poll(self, seconds: float) -> list[tuple[int, int]]:
        """Return events, waiting for them up to `seconds`."""
        return self._poller.poll(math.ceil(seconds * 1000))

    def close(self) -> None:
        """Do nothing: it has no descriptor of its own."""
