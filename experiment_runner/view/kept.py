"""Answers, computed again only when there is something new, and seldom enough not to slow a run down."""

from __future__ import annotations

import time
from collections import OrderedDict
from collections.abc import Callable, Hashable
from typing import Any, Final, NamedTuple

__all__ = ["Kept"]

_MOST: Final = 32
_REST: Final = 20
"""An answer to the same question stands for this many times as long as it took to compute: 5 % of a core."""


class _Answer(NamedTuple):
    signs: object
    until: float
    value: Any


class Kept:
    """The newest answers, by question."""

    def __init__(self) -> None:
        self._answers: OrderedDict[Hashable, _Answer] = OrderedDict()

    def get(self, question: Hashable, signs: object, compute: Callable[[], Any]) -> Any:
        """Return the answer to a question; `signs` are equal as long as it cannot have changed."""
        now = time.monotonic()
        found = self._answers.get(question)
        if found is None or (found.signs != signs and now >= found.until):
            value = compute()
            done = time.monotonic()
            found = self._answers[question] = _Answer(signs, done + _REST * (done - now), value)
            if len(self._answers) > _MOST:
                self._answers.popitem(last=False)
        self._answers.move_to_end(question)
        return found.value
