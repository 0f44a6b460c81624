"""Poll briefly for an expected message before sleeping: waking up takes longer than many answers.

An idle processor sleeps too, and in a virtual machine takes 50 to 100 microseconds to wake up. A step of many
games would wait for that four times: on its way to the hub, to the agent, and back.

Each part that adapts was left out in turn, with two cores busy, with one core, and beside two busy loops.
Without rests after a lost core, 0.02 to 0.44 of the steps a second were left; with rests that do not double,
0.8 where two programs share a core; if nothing is polled during a rest, 0.4 to 0.7 in four runs through the
gateway; if no wait is skipped after a spin without success, 0.35 to 1.0, and beside a player that takes a
millisecond the hub took 3.6 times the CPU.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Final, TypeVar

from glue.system import clock

SPIN_SECONDS: Final = 100e-6
"""Seconds to poll for an expected message: fast players, and their hub, answer within this time."""

LONG_SPIN_SECONDS: Final = 300e-6
"""Seconds to poll for a message of many games: 64 games of Infinite Mario are stepped within this time."""

SEVERAL_CORES: Final = not hasattr(os, "sched_getaffinity") or len(os.sched_getaffinity(0)) > 1
"""Whether this process may use several cores."""

_LOST_SECONDS: Final = 250e-6
"""Seconds after which a yielded core comes back too late, because another program had it."""

_REST: Final = 100.0
"""Ratio of the time without yields after such a loss to the time lost: at most 1 % is lost."""

_MAX_REST: Final = 10.0
"""Maximum number of seconds without yields; the number doubles when the core is lost again soon."""

_MAX_MISSES: Final = 8
"""Maximum of n, where after n spins in a row without success the next 2**n waits do not spin."""

_LOAD: Final = Path("/proc/loadavg")

_CHECKED: Final = 64
"""Number of waits for which it is assumed that cores are free, or are not."""

T = TypeVar("T")


def cores_are_free() -> bool:
    """Return whether all programs that want to run now fit on the cores that this process may use.

    Where the system does not tell, as in a container that hides /proc/loadavg, return False.
    """
    try:
        running = int(_LOAD.read_text().split()[3].partition("/")[0])
    except (OSError, LookupError, ValueError):
        return False
    return running <= len(os.sched_getaffinity(0))


class Spin:
    """Decides whether a wait for an expected message begins with polling, and polls.

    Args:
        seconds: duration of a poll; may be set later.
        free: tells whether cores are free. If it is given, nothing is polled while they are not, or while the
            core is not yielded, as by a player: it would take the time of the hub or of the other player.
    """

    __slots__ = ("_checked", "_free", "_misses", "_rest", "_skipped", "_yield_at", "seconds")

    def __init__(self, seconds: float, free: Callable[[], bool] | None = None) -> None:
        self.seconds: float = seconds
        self._free = free
        self._checked = 0  # the number of waits still to come until `free` is asked again
        self._misses = 0
        self._skipped = 0  # the number of waits still to come without a spin
        self._yield_at = 0.0  # the time from which the core is yielded
        self._rest = 0.0  # seconds without yields after the last loss

    def until_found(self, poll: Callable[[], T | None]) -> T | None:
        """Return the first result of `poll` that is not None, or None if there is none in time."""
        if self._skipped:
            self._skipped -= 1
            return None
        if self._free is not None:
            if not self._checked:
                if not self._free():
                    self._skipped = _CHECKED
                    return None
                self._checked = _CHECKED
            self._checked -= 1
        began = before = clock.monotonic()
        yielding = began >= self._yield_at
        if not yielding and (self._free is not None or not SEVERAL_CORES):
            return None  # on a single core no peer could answer meanwhile
        while True:
            if yielding:
                clock.give_way()
            now = clock.monotonic()
            found = poll()
            if yielding and now - before > _LOST_SECONDS:
                again = now - self._yield_at < self._rest
                self._rest = min(2 * self._rest if again else _REST * (now - before), _MAX_REST)
                self._yield_at = now + self._rest
                return found
            if found is not None:
                self._misses = 0
                return found
            if now - began >= self.seconds:
                self._misses = min(self._misses + 1, _MAX_MISSES)
                self._skipped = 2**self._misses
                return None
            before = now
