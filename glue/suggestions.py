"""What to suggest for a word that is unknown: the near misses, or what there is to choose from."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Final

__all__ = ["did_you_mean"]

_MAX_NEAR: Final = 3
_MAX_LISTED: Final = 30


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """Return the end of a message about an unknown word, such as `; did you mean sarsa?`.

    Without a near miss it lists what is known, such as `; choose from mines, skeleton`. It is
    empty if nothing is known.
    """
    known = list(known)
    near = difflib.get_close_matches(word, known, n=_MAX_NEAR)
    if near:
        return f"; did you mean {' or '.join(near)}?"
    if not known:
        return ""
    listed = known if len(known) <= _MAX_LISTED else [*known[:_MAX_LISTED], "..."]
    return f"; choose from {', '.join(listed)}"
