"""The hub's event loop: one thread that waits for descriptors and for time to pass.

Nothing called from it may block.

Unsolicited work, such as accepting connections or reading messages sent out of turn, goes through a queue.
Each turn of the loop does one piece of it, and all of it takes at most a fifth of the time: however many
peers flood the hub, a session that plays has the rest.
"""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Callable
from contextlib import suppress
from heapq import heappop, heappush
from typing import Final, Protocol, TypeVar

from glue.system import clock, network, threads
from glue.system.spinning import LONG_SPIN_SECONDS, SPIN_SECONDS, Spin

READ: Final = network.POLLIN
WRITE: Final = network.POLLOUT
FAILURE: Final = 0
"""Descriptors with no registered interest still report errors."""

_SHARE: Final = 0.2
"""Maximum share of the time for the queue."""

_MAX_SAVED: Final = 0.02
"""Seconds of its share that the queue can save up while it is empty."""

_DIRECT: Final = 32
"""Number of spins, which read only from the peer that was sent a call, per poll of all descriptors."""

_GRACE_SECONDS: Final = 0.05
"""Seconds for which the thread in `run` leaves the loop to another thread that has taken it."""

_WAKE_SIZE: Final = 4096

Events = list[tuple[int, int]]
"""Descriptors, each with its events."""

Work = Callable[[float], None]
"""A function of the time, as `time.monotonic` returns it."""

Result = TypeVar("Result")


class Watched(Protocol):
    """The owner of a descriptor."""

    def turn(self, now: float) -> None:
        """Handle the descriptor, which is ready or has failed."""


class Source(Watched, Protocol):
    """A connection whose answer can be expected."""

    def glance(self) -> bool | None:
        """Read data, and return whether it has to be handled, by `turn`; None if there is none yet."""


class Loop:
    """Serves ready descriptors, calls functions at ticks and at given times, and works through a queue.

    Only one thread takes turns at any time: the thread in `run`, or another in `alone`.

    Args:
        every: seconds between ticks.
        log: takes a line for people, about errors that end a connection.

    Attributes:
        log: as given.
        stopping: the reason for which it ends or has ended; None until `stop`.
    """

    def __init__(self, every: float, log: Callable[[str], None]) -> None:
        self.log = log
        self.stopping: str | None = None
        self._every = every
        self._tick_at = clock.monotonic() + every
        self._poller = network.Poller()
        self._watched: dict[int, Watched] = {}
        self._tickers: list[Work] = []
        self._queue: deque[Work] = deque()
        self._due: list[tuple[float, int, Work]] = []  # a heap; the number decides between equal times
        self._numbers = itertools.count()
        self._saved = _MAX_SAVED
        self._saved_at = 0.0
        self._expected: Source | None = None
        self._several = False  # answers of several sources are expected
        self._spin = Spin(SPIN_SECONDS)
        self._spins = 0
        self._mutex = threads.RLock()  # it knows whether this thread holds it
        self._times_asked = 0
        self._wake = _Wake()
        self.watch(self._wake.fileno(), READ, self._wake)

    def watch(self, fd: int, events: int, owner: Watched) -> None:
        """Give `owner` a turn whenever `fd` is ready or has failed; `events` are READ and WRITE."""
        if fd in self._watched:
            self._poller.modify(fd, events)
        else:
            self._poller.register(fd, events)
        self._watched[fd] = owner

    def unwatch(self, fd: int) -> None:
        """Undo `watch`, if it was called."""
        if self._watched.pop(fd, None) is not None:
            self._poller.unregister(fd)

    def queue(self, work: Work) -> None:
        """Call `work` once, after all work queued before, as the queue's share of the time allows."""
        self._queue.append(work)

    def at(self, time: float, work: Work) -> None:
        """Call `work` once, when `time` has come, after the messages that were received until then."""
        heappush(self._due, (time, next(self._numbers), work))

    def on_tick(self, tick: Work) -> None:
        """Call `tick` at every tick; several are called in the order in which they were given."""
        self._tickers.append(tick)

    def expect(self, source: Source) -> None:
        """Note that the peer behind `source` was sent a call, which it usually answers at once."""
        if self._expected is not None and self._expected is not source:
            self._several = True
        self._expected = source

    def spin_longer(self) -> None:
        """Note that a peer with many games, or an agent for them, has joined: its answers take longer."""
        self._spin.seconds = LONG_SPIN_SECONDS

    def run(self) -> None:
        """Take turns until `stop`, except while other threads take them."""
        asked = 0
        while self.stopping is None:
            if asked != self._times_asked or not self._mutex.acquire(blocking=False):
                # Another thread has the loop, or had it a moment ago and may soon ask for it again.
                asked = self._times_asked
                clock.sleep(_GRACE_SECONDS)
                continue
            try:
                while asked == self._times_asked and self.stopping is None:
                    self.turn()
            finally:
                self._mutex.release()

    def alone(self, work: Callable[[], Result]) -> Result:
        """Call `work`, which may take turns, while no other thread does; return its result."""
        self._times_asked += 1
        # KeyboardInterrupt may be raised after any call, even one that has acquired the lock. So the lock is
        # released even if this thread seems not to hold it, which a `with` would not do.
        try:
            mine = self._mutex.acquire(blocking=False)
            while not mine:
                # A busy machine may have stopped this thread for longer than `run` waited for it: ask again.
                self._times_asked += 1
                self._wake.up()
                mine = self._mutex.acquire(timeout=_GRACE_SECONDS)
            return work()
        finally:
            try:  # noqa: SIM105  # another call here could be interrupted before the release
                self._mutex.release()
            except RuntimeError:  # interrupted before the lock was acquired
                pass

    def turn(self, seconds: float = math.inf) -> None:
        """Wait up to `seconds` until there is work, and do it.

        The work is ready descriptors, what is due, one piece of the queue, and a tick.
        """
        events: Events = []
        found: bool | None = None
        expected = self._expected
        if expected is not None:
            self._expected = None
            self._spins += 1
            if not self._several:
                if not self._spins % _DIRECT:
                    events = self._poller.poll(0)
                found = None if events else self._spin.until_found(expected.glance)
            self._several = False
        now = clock.monotonic()
        if found and expected is not None:
            expected.turn(now)
        elif not events:
            wait = min(seconds, self._tick_at - now)
            if self._queue:
                wait = min(wait, -self._saved / _SHARE)
            if self._due:
                wait = min(wait, self._due[0][0] - now)
            events = self._poller.poll(max(wait, 0))
            now = clock.monotonic()
        for fd, _ in events:
            # A turn before this one may have unwatched the descriptor.
            watched = self._watched.get(fd)
            if watched is not None:
                watched.turn(now)
        while self._due and self._due[0][0] <= now:
            heappop(self._due)[2](now)
        if self._queue:
            self._work_off()
        if now >= self._tick_at:
            for tick in self._tickers:
                tick(now)
            self._tick_at = now + self._every

    def _work_off(self) -> None:
        now = clock.monotonic()
        self._saved = min(_MAX_SAVED, self._saved + (now - self._saved_at) * _SHARE)
        self._saved_at = now
        if self._saved > 0:
            self._queue.popleft()(now)
            self._saved -= clock.monotonic() - now

    def stop(self, reason: str) -> None:
        """Make `run` end; may be called from any thread or signal handler."""
        self.stopping = self.stopping or reason
        self._wake.up()

    def close(self) -> None:
        """Close the loop's own descriptors."""
        self._wake.close()
        self._poller.close()


class _Wake:
    """A pair of sockets by which other threads and signal handlers wake the loop."""

    def __init__(self) -> None:
        self._reader, self._writer = network.socketpair()
        self._reader.setblocking(False)
        self._writer.setblocking(False)
        self.fileno = self._reader.fileno

    def up(self) -> None:
        """Wake the loop."""
        with suppress(OSError):  # full or closed: the loop is awake or has ended
            self._writer.send(b"\0")

    def turn(self, now: float) -> None:
        """Discard the wake-ups."""
        self._reader.recv(_WAKE_SIZE)

    def close(self) -> None:
        """Close both sockets."""
        self._reader.close()
        self._writer.close()
