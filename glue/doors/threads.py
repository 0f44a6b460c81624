"""Threads, and what they wait for each other with."""

from __future__ import annotations

from threading import Condition, Event, Lock, Thread

__all__ = ["Condition", "Event", "Lock", "Thread"]
