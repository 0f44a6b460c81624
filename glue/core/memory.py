"""A bound on what a hub keeps in all, and who has to go when there is no room for more."""

from __future__ import annotations

from typing import Protocol

__all__ = ["Holder", "Memory"]


class Holder(Protocol):
    """Something for which bytes are kept: a connection, or a session."""

    @property
    def seated(self) -> bool:
        """Whether it takes part in a session; what does not is given up first."""
        ...

    def evict(self, why: str) -> None:
        """Give up all that is kept for it, and tell its peers why."""
        ...


class Memory:
    """Bytes kept by holders; when they are more than `limit` in all, `relieve` evicts the largest holder.

    Args:
        limit: bytes.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._total = 0
        self._held: dict[Holder, int] = {}

    def hold(self, holder: Holder, size: int) -> None:
        """Note that `size` bytes are kept for `holder` now."""
        self._total += size - self._held.pop(holder, 0)
        if size:
            self._held[holder] = size

    def relieve(self) -> None:
        """Evict the largest holders until there is room. They may be in use until then, but not after."""
        while self._total > self._limit:
            largest = max(self._held, key=lambda known: (not known.seated, self._held[known]))
            held = self._held.pop(largest)
            self._total -= held
            largest.evict(
                f"it kept {held / 2**20:.0f} MiB, the most of all, when this hub had no room for more; "
                f"it may keep {self._limit / 2**20:.0f} MiB (--max-memory)"
            )
