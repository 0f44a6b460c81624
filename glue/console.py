"""Lines for people: printed to standard error, so that standard output carries results alone."""

from __future__ import annotations

import select
import sys
from typing import Final

__all__ = ["is_stuck", "say"]

_STDERR: Final = 2


def say(line: str) -> None:
    """Print a line to standard error, at once."""
    print(line, file=sys.stderr, flush=True)


def is_stuck() -> bool:
    """Return whether printing would wait, because standard error is a full pipe that is not being read."""
    try:
        return not select.select([], [_STDERR], [], 0)[1]
    except (OSError, ValueError):  # closed
        return True
