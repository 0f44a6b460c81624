"""A limit on the memory of a hub, and the choice of the holders to evict when it is exceeded."""

from __future__ import annotations

from typing import Final, Protocol

_SMALL: Final = 65_536
"""Bytes that a connection may hold before it joins a session without being evicted before others."""


class Holder(Protocol):
    """Something that uses memory: a connection, or a session."""

    @property
    def seated(self) -> bool:
        """Whether it takes part in a session; holders that do not, and are not small, are evicted first."""
        ...

    def evict(self, why: str) -> None:
        """Release all memory used for it, and send its peers the reason."""
        ...


class Memory:
    """Memory used by all holders; when its total exceeds `limit`, `relieve` evicts the largest holder.

    Args:
        limit: maximum total, in bytes.

    Attributes:
        held: the number of bytes that each holder uses.
        total: their sum.
        exceeded: whether the total exceeds the limit.
    """

    def __init__(self, limit: int) -> None:
        self.exceeded: bool = False
        self._limit = limit
        self._wanted = 0  # bytes for which `make_room` found no room
        self.total: int = 0
        self.held: dict[Holder, int] = {}

    def hold(self, holder: Holder, size: int) -> None:
        """Note that `holder` now uses `size` bytes."""
        self.total += size - self.held.pop(holder, 0)
        if size:
            self.held[holder] = size
        self.exceeded = self.total + self._wanted > self._limit

    def has_room(self, size: int) -> bool:
        """Return whether `size` more bytes are within the limit."""
        return self.total + size <= self._limit

    def make_room(self, size: int) -> bool:
        """Return whether `size` more bytes are within the limit; if not, let `relieve` make room for them."""
        if not self.has_room(size):
            self._wanted = max(self._wanted, size)
            self.exceeded = True
        return not self.exceeded

    def relieve(self) -> None:
        """Evict the largest holders until there is room; callers must not use them again."""
        while self.exceeded and self.held:
            largest = max(
                self.held,
                key=lambda known: (self.held[known] > _SMALL and not known.seated, self.held[known]),
            )
            held = self.held[largest]
            self.hold(largest, 0)
            largest.evict(
                f"it used {held / 2**20:.0f} MiB, more than any other, when the hub reached its limit of "
                f"{self._limit / 2**20:.0f} MiB (max_memory)"
            )
        self._wanted = 0
