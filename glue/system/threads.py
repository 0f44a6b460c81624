"""Threads, and the means by which they wait for each other."""

from __future__ import annotations

from threading import Condition, Event, RLock, Thread, Timer

__all__ = ["Condition", "Event", "RLock", "Thread", "Timer"]
