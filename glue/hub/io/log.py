"""A log that never blocks its callers, even if it is printed slowly or not at all.

The hub's loop must not wait for a terminal or a pipe that nobody reads. A `Log` keeps lines in a queue of
limited length, from which a thread writes them. Lines that arrive when the queue is full are counted and
dropped.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from datetime import datetime
from enum import IntEnum
from typing import Final

from glue.system import threads

_CAPACITY: Final = 1000
"""Maximum number of lines that wait to be written."""


class LogLevel(IntEnum):
    """The level of a log line; a log writes the lines up to a level."""

    ERROR = 0
    """An internal error of the hub."""

    PEERS = 1
    """A peer that joins, leaves or is refused."""

    CONNECTIONS = 2
    """Every connection."""


class Log:
    """A function that takes lines from any thread, and never blocks.

    Args:
        write: writes a line, in the log's own thread; it may take any time.
        level: the level up to which lines are written.
        stamped: whether each line begins with the local time at which it was taken.
    """

    def __init__(
        self, write: Callable[[str], None], level: LogLevel = LogLevel.PEERS, stamped: bool = False
    ) -> None:
        self._write = write
        self._level = level
        self._stamped = stamped
        self._lines: deque[str] = deque()
        self._dropped = 0
        self._closed = False
        self._changed = threads.Condition()
        self._thread: threads.Thread | None = None

    def __call__(self, line: str, level: LogLevel = LogLevel.PEERS) -> None:
        """Have `line` written, or dropped if too many lines wait already."""
        if level > self._level:
            return
        if self._stamped:
            line = f"{datetime.now():%Y-%m-%d %H:%M:%S} {line}"
        with self._changed:
            if len(self._lines) >= _CAPACITY or self._closed:
                self._dropped += 1
                return
            self._lines.append(line)
            if self._thread is None:
                self._thread = threads.Thread(target=self._run, name="log", daemon=True)
                self._thread.start()
            self._changed.notify()

    def error(self, line: str) -> None:
        """Log a line about an internal error of the hub."""
        self(line, LogLevel.ERROR)

    def connection(self, line: str) -> None:
        """Log a line about a connection."""
        self(line, LogLevel.CONNECTIONS)

    def close(self, seconds: float) -> None:
        """Wait at most `seconds` until all lines are written; later lines are dropped."""
        with self._changed:
            self._closed = True
            self._changed.notify()
        if self._thread is not None:
            self._thread.join(seconds)

    def _run(self) -> None:
        while True:
            with self._changed:
                self._changed.wait_for(lambda: self._lines or self._dropped or self._closed)
                lines = list(self._lines)
                self._lines.clear()
                dropped, self._dropped = self._dropped, 0
                if not lines and not dropped:
                    return
            for line in lines:
                self._write(line)
            if dropped:
                self._write(
                    f"{dropped} more lines were dropped: they arrived faster than they could be written"
                )
