"""The time that players take to answer: reports of slow calls, and the limit of an agent's time.

The hub measures the time from sending a call until reading its answer. The time of an answer beyond its limit
is drained from a bank, as in Kaggle's environments: an agent may think for long now and then, but not always.
`agent_seed` and `agent_init`, in which an agent loads its data, have their own limit.

Where the processor time of an agent is known, it counts beside the time on the clock: what its threads use
beyond that, together or between its answers, is drained as well.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Final

from glue.hub.config import TimeLimits
from glue.wire.messages import Kind

_FIRST_SECONDS: Final = 5.0
"""Seconds without an answer after which a call is reported."""

_FACTOR: Final = 6.0
"""Factor between the times of successive reports of the same call: 5 s, 30 s, 180 s, ..."""

_READ_SECONDS: Final = 0.01
"""Seconds between two readings of the processor time, each of which takes the hub some microseconds."""

_STARTING: Final = frozenset({Kind.AGENT_SEED, Kind.AGENT_INIT})


class TimeBank:
    """The time of one agent.

    Args:
        limits: the limits of its time.
        clock: returns seconds since an arbitrary time.
        processor: returns the seconds that the agent has used of processors, None if unknown; None if that
            does not count.
    """

    def __init__(
        self,
        limits: TimeLimits,
        clock: Callable[[], float],
        processor: Callable[[], float | None] | None = None,
    ) -> None:
        self._limits = limits
        self._clock = clock
        self._processor = processor
        self._bank = limits.bank_seconds
        self._start = limits.start_seconds
        self._total = limits.total_seconds
        self._starting = False
        self._called_at: float | None = None
        # Since the last reading of the processor time:
        self._read_at = clock()
        self._used: float | None = None
        self._answers = 0
        self._waited = 0.0
        self._drained = 0.0

    @property
    def left(self) -> tuple[float, float]:
        """The seconds left in the bank, and for all answers together; after the last answer."""
        return max(0.0, self._bank), max(0.0, self._total)

    def called(self, kind: Kind) -> None:
        """Note that a call is sent to the agent."""
        self._starting = kind in _STARTING
        now = self._called_at = self._clock()
        if self._processor is not None and self._used is None and not self._starting:
            self._count_processor(self._processor(), now)

    def answered(self) -> str | None:
        """Account for the time of an answer; return why the agent is out of time, or None.

        The reason completes a sentence about the agent.
        """
        if self._called_at is None:
            return None
        now = self._clock()
        seconds = now - self._called_at
        self._called_at = None
        if self._starting:
            self._start -= seconds
            self._used = None
        else:
            self._total -= seconds
            excess = seconds - self._limits.step_seconds
            if excess > 0:
                self._bank -= excess
                self._drained += excess
            if self._processor is not None:
                self._answers += 1
                self._waited += seconds
                if now - self._read_at >= _READ_SECONDS:
                    self._count_processor(self._processor(), now)
        return self._over(0.0)

    def _count_processor(self, used: float | None, now: float) -> None:
        """Drain what the agent has used of processors since the last reading, beyond time on the clock."""
        if used is not None and self._used is not None:
            spent = used - self._used
            self._total -= max(0.0, spent - self._waited)
            self._bank -= max(0.0, spent - self._answers * self._limits.step_seconds - self._drained)
        self._read_at, self._used = now, used
        self._answers, self._waited, self._drained = 0, 0.0, 0.0

    def overdue(self) -> str | None:
        """Return why the agent is out of time before it has answered; None if it has time left."""
        return None if self._called_at is None else self._over(self._clock() - self._called_at)

    def _over(self, waiting: float) -> str | None:
        """Return why the time is over, or None, if the outstanding call has lasted `waiting` seconds."""
        limits = self._limits
        if self._starting:
            if waiting > self._start:
                return f"took more than {limits.start_seconds:g} s to initialise"
        elif waiting > self._total:
            return f"used more than {limits.total_seconds:g} s in all"
        elif max(0.0, waiting - limits.step_seconds) > self._bank:
            return (
                f"ran out of time: its bank of {limits.bank_seconds:g} s is empty "
                f"({limits.step_seconds:g} s are free per answer)"
            )
        return None


class SlowCalls:
    """Decides when to report a call without an answer, at growing intervals."""

    __slots__ = ("_call", "_report_after", "_since")

    def __init__(self) -> None:
        self._call: int | None = None  # only its sequence number, as a message may be large
        self._since = 0.0
        self._report_after = _FIRST_SECONDS

    def overdue(self, call: int | None, now: float, explained: bool) -> float | None:
        """Return the seconds to report if it is time to report `call`, otherwise None.

        Args:
            call: the sequence number of the outstanding call, if any; a call is timed from when it is first
                passed.
            now: the time in seconds.
            explained: whether the player has said why it takes long; the first report is then omitted.
        """
        if call is None or call != self._call:
            self._call, self._since, self._report_after = call, now, _FIRST_SECONDS
            return None
        if now - self._since < self._report_after:
            return None
        seconds = self._report_after
        self._report_after *= _FACTOR
        return None if explained and seconds == _FIRST_SECONDS else seconds
