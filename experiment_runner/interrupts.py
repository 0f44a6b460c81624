"""Ctrl-C and SIGTERM, deferred for a moment while an episode is under way.

An episode that is cut in the middle has to be repeated, and so has every one since the newest checkpoint.
So a signal first lets the episode end and its checkpoint be stored; but it never waits for long, and a
second signal does not wait at all.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from queue import SimpleQueue
from types import FrameType, TracebackType
from typing import Final, Self

__all__ = ["GRACE_SECONDS", "Interrupts"]

GRACE_SECONDS: Final = 0.5
"""How long a signal is deferred at most."""

_Handler = Callable[[int, FrameType | None], object]


class Interrupts:
    """Defers SIGINT and SIGTERM in the body of `deferred`, once this context is entered.

    Signals that have no handler of Python's, and those of a context that is entered in another thread than
    the main one, are left alone.

    Args:
        grace: seconds for which a signal is deferred at most.

    Attributes:
        requested: a signal is being deferred.
    """

    def __init__(self, grace: float = GRACE_SECONDS) -> None:
        self.requested = False
        self._grace = grace
        self._deferring = False
        self._overdue = False
        self._deliver: Callable[[], object] | None = None
        self._handlers: dict[int, _Handler] = {}
        self._ended = threading.Event()
        # Its put may interrupt itself, as a signal handler can; an Event's set may not.
        self._received: SimpleQueue[int] = SimpleQueue()

    def __enter__(self) -> Self:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                handler = signal.getsignal(number)
                if callable(handler):
                    self._handlers[number] = handler
                    signal.signal(number, self._handle)
            threading.Thread(target=self._watch, name="interrupts", daemon=True).start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended.set()
        self._received.put(0)
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        self._handlers.clear()

    @contextmanager
    def deferred(self) -> Iterator[None]:
        """Let the body come to its end before a signal has its effect.

        Raises:
            KeyboardInterrupt: at the end, if there was a signal; within the body if there is a second one,
                or the body does not end in time.
        """
        self._deferring = True
        try:
            yield
        finally:
            self._deferring = False
            self.check()

    def check(self) -> None:
        """Let a signal that is being deferred have its effect now.

        Raises:
            KeyboardInterrupt: there is one.
        """
        deliver, self._deliver = self._deliver, None
        if deliver is not None:
            self._deferring = False
            self._ended.set()
            deliver()

    def _handle(self, number: int, frame: FrameType | None) -> None:
        def deliver() -> object:
            return self._handlers[number](number, frame)

        overdue, self._overdue = self._overdue, False
        if overdue and not self._deferring:
            return  # the body has ended just in time
        if overdue or self._deliver is not None or not self._deferring:
            deliver()
            return
        self._deliver = deliver
        self.requested = True
        self._received.put(number)

    def _watch(self) -> None:
        number = self._received.get()
        if not self._ended.wait(self._grace):
            self._overdue = True
            signal.pthread_kill(threading.main_thread().ident or 0, number)
