"""Suggestions for an unknown word: the near misses, or all the choices."""

from __future__ import annotations

from collections.abc import Iterable
from difflib import SequenceMatcher
from typing import Final

_MAX_NEAR: Final = 3
_NEAR: Final = 0.6
_MAX_LISTED: Final = 30


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return the end of a message about an unknown word, such as `; did you mean sarsa?`.

    Without a near miss, list the known words, such as `; choose from mines, skeleton`; the
    result is empty if there are none.
    """
    known = list(known)
    likeness = {other: _likeness(word, other) for other in known}
    near = sorted((other for other in known if likeness[other] >= _NEAR), key=lambda other: -likeness[other])
    if near := near[:_MAX_NEAR]:
        return f"; did you mean {' or '.join(near)}?"
    if not known:
        return ""
    listed = known if len(known) <= _MAX_LISTED else [*known[:_MAX_LISTED], "..."]
    return f"; choose from {', '.join(listed)}"


def _likeness(word: str, other: str) -> float:
    """Return the likeness, 0 to 1. Swapped letters, as in srasa, are sometimes found only from the end."""
    there, back = SequenceMatcher(None, word, other), SequenceMatcher(None, word[::-1], other[::-1])
    return max(there.ratio(), back.ratio())
