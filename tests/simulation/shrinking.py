"""Reduction of a run's faults to those that a broken promise needs."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from tests.simulation.faults import Fault


def needed(faults: Sequence[Fault], fails: Callable[[list[Fault]], bool]) -> list[Fault]:
    """Return a part of `faults` that still fails, of which none can be left out."""
    kept, size = list(faults), max(1, len(faults) // 2)
    while True:
        at, fewer = 0, False
        while at < len(kept):
            tried = kept[:at] + kept[at + size :]
            if fails(tried):
                kept, fewer = tried, True
            else:
                at += size
        if size == 1 and not fewer:
            return kept
        size = max(1, size // 2)
