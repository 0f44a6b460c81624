"""A clock in the hand of a test."""

from __future__ import annotations


class Clock:
    """Stands still until a test sets `now`, in seconds."""

    def __init__(self, now: float = 0.0) -> None:
        self.now = now

    def __call__(self) -> float:
        return self.now
