"""Threads, and what they wait for each other with."""

from __future__ import annotations

from threading import Condition, Event, RLock, Thread

__all__ = ["Condition", "Event", "RLock", "Thread"]
