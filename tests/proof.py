"""Tests that prove more the longer they run: some seconds in `make test`, minutes in `make proof`.

They have the marker `proof`, and take their sizes from here.
"""

from __future__ import annotations

import os
from typing import TypeVar

_T = TypeVar("_T")

FULL = os.environ.get("GLUE_PROOF") == "full"


def size(usual: _T, full: _T) -> _T:
    """Return the size of a proof in `make test`, or in `make proof`."""
    return full if FULL else usual
