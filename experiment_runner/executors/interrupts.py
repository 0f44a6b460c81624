"""Ctrl-C and SIGTERM, deferred briefly during an episode.

An episode that is interrupted has to be repeated, as has every episode since the newest checkpoint. So a
signal takes effect after the episode has ended and a checkpoint is stored; but it is deferred for a limited
time only, and a second signal takes effect at once.
"""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from queue import SimpleQueue
from types import FrameType
from typing import Self

import glue.system.forks  # noqa: F401  # for the handlers that are set here
from experiment_runner.executors.job import GRACE_SECONDS


class Terminated(KeyboardInterrupt):
    """A worker has to end: on SIGTERM, or because its experiment is over."""


_Handler = Callable[[int, FrameType | None], object]


class Interrupts:
    """Context in which SIGINT and SIGTERM are deferred during the body of `deferred`.

    Signals without a Python handler are not affected; nor is any signal if the context is entered outside the
    main thread.

    Args:
        grace: maximum time in seconds for which a signal is deferred.

    Attributes:
        requested: whether a signal is being deferred.
    """

    def __init__(self, grace: float = GRACE_SECONDS) -> None:
        self.requested: bool = False
        self._grace = grace
        self._deferring = False
        self._overdue = False
        self._pending: int | None = None
        self._handlers: dict[int, _Handler] = {}
        self._ended = threading.Event()
        # A signal handler needs a reentrant call: a SimpleQueue's put is one, an Event's set is not.
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

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._received.put(0)
        for number, handler in self._handlers.items():
            signal.signal(number, handler)
        self._handlers.clear()

    @contextmanager
    def deferred(self) -> Iterator[None]:
        """Let the body complete before a signal takes effect.

        Raises:
            KeyboardInterrupt: after the body, if there was a signal; within it, on a second signal or if the
                body does not end in time.
        """
        self._deferring = True
        try:
            yield
        finally:
            self._deferring = False
            self.check()

    def check(self) -> None:
        """Let a deferred signal take effect now.

        Raises:
            KeyboardInterrupt: a signal was deferred.
        """
        number, self._pending = self._pending, None
        if number is not None:
            self._deferring = False
            self._ended.set()
            self._handlers[number](number, None)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        overdue, self._overdue = self._overdue, False
        if overdue and not self._deferring:
            return  # the body ended in time after all
        if self._deferring and self._pending is None:
            self._pending = number
            self.requested = True
            self._received.put(number)
        else:  # the body takes too long, this is the second signal, or nothing is deferred
            self._handlers[number](number, frame)

    def _watch(self) -> None:
        number = self._received.get()
        if not self._ended.wait(self._grace):
            self._overdue = True
            signal.pthread_kill(threading.main_thread().ident or 0, number)
