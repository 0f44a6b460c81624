"""Sizes of the tests that check more the longer they run: seconds in `make test`, minutes in `make proof`.

These tests have the marker `proof`.
"""

from __future__ import annotations

import os
from typing import TypeVar

_T = TypeVar("_T")

FULL = os.environ.get("GLUE_PROOF") == "full"


def size(usual: _T, full: _T) -> _T:
    """Return `usual` in `make test`, and `full` in `make proof`."""
    return full if FULL else usual
