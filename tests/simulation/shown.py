"""A judge of the moments that an observer is shown: their numbers, and the counts of the episode."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from typing import Any, Final, NamedTuple

from glue.types import CUT_OFF
from glue.wire.messages import Kind, Message

MOMENTS: Final = {Kind.OBSERVED_START, Kind.OBSERVED_STEP}


class _Moment(NamedTuple):
    number: int
    episode: int
    steps: int
    total: float


class Shown:
    """Compares each moment with the last one that the same connection was shown.

    Args:
        problem: called with a description of each difference.
    """

    def __init__(self, problem: Callable[[str], None]) -> None:
        self._problem = problem
        self._wanted: dict[Hashable, int] = {}
        self._last: dict[Hashable, _Moment] = {}

    def joined(self, view: Hashable) -> None:
        """Note that an observer is let in anew: its moments are counted from the beginning."""
        self._last.pop(view, None)

    def wanted(self, view: Hashable, moments: Any) -> None:
        """Note that an observer asks for so many moments, in place of what it asked for before."""
        self._wanted[view] = moments

    def shown(self, view: Hashable, message: Message) -> None:
        """Judge (g): an observer is shown no more than it wants, and no moment is missed without a gap."""
        scalars: Any = message.scalars
        step = message.kind is Kind.OBSERVED_STEP
        episode, steps, total, reward, terminal = scalars if step else (*scalars, 1, 0.0, 0.0, False)
        last, moment = self._last.get(view), _Moment(message.seq, episode, steps, total)
        self._last[view] = moment
        self._wanted[view] = self._wanted.get(view, 0) - 1
        right = self._wanted[view] >= 0 and (last is None or message.seq > last.number)
        if last is not None and right:
            passed = message.seq - last.number
            if step and episode == last.episode:
                ended = terminal and terminal != CUT_OFF
                right = steps == last.steps + passed - ended
                right &= passed > 1 or total == last.total + reward
            else:
                right = episode > last.episode and (passed > 1 or (not step and episode == last.episode + 1))
        if not right:
            self._problem(
                f"(g) an observer that saw {last} and wanted {self._wanted[view] + 1} more is shown {moment}"
            )
