"""Calls that have not been answered for a long time."""

from __future__ import annotations

from typing import Final

_FIRST_SECONDS: Final = 5.0
"""Seconds without an answer after which a call is reported."""

_FACTOR: Final = 6.0
"""Factor between the times of successive reports of the same call: 5 s, 30 s, 180 s, ..."""


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
