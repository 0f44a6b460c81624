"""Channels to peers, as sessions see them, and a limit on the memory of channels and sessions."""

from __future__ import annotations

from typing import Final, Protocol

from glue.wire.messages import Message, Role

_SMALL: Final = 65_536
"""Bytes that a connection may hold before it joins a session without being evicted before others."""


class Channel(Protocol):
    """A connection over which messages are received and sent."""

    def deliver(self, message: Message) -> bool:
        """Send `message`; return False, having sent nothing, if the other side is gone or does not read."""

    def admits(self, role: Role, session: str) -> bool:
        """Return whether a peer of this channel may join `session` as `role`; see `glue.hub.config.Bind`."""


class Holder(Protocol):
    """Something that uses memory: a connection, or a session."""

    @property
    def in_session(self) -> bool:
        """Whether it takes part in a session; holders that do not, and are not small, are evicted first."""

    def evict(self, why: str) -> None:
        """Release all memory used for it, and send its peers the reason."""


class Memory:
    """Memory used by all holders; `enforce` evicts the largest holders until the total is within `limit`.

    Args:
        limit: maximum total, in bytes.

    Attributes:
        accounts: the number of bytes that each holder uses.
        total: their sum.
        exceeded: whether the total exceeds the limit.
    """

    def __init__(self, limit: int) -> None:
        self.exceeded: bool = False
        self._limit = limit
        self._wanted = 0  # bytes for which `make_room` found no room
        self.total: int = 0
        self.accounts: dict[Holder, int] = {}

    def account(self, holder: Holder, size: int) -> None:
        """Note that `holder` now uses `size` bytes."""
        self.total += size - self.accounts.pop(holder, 0)
        if size:
            self.accounts[holder] = size
        self.exceeded = self.total + self._wanted > self._limit

    def has_room(self, size: int) -> bool:
        """Return whether `size` more bytes are within the limit."""
        return self.total + size <= self._limit

    def make_room(self, size: int) -> bool:
        """Return whether `size` more bytes are within the limit; if not, let `enforce` make room for them."""
        if not self.has_room(size):
            self._wanted = max(self._wanted, size)
            self.exceeded = True
        return not self.exceeded

    def enforce(self) -> None:
        """Evict the largest holders until there is room; callers must not use them again."""
        while self.exceeded and self.accounts:
            largest, held = max(
                self.accounts.items(), key=lambda one: (one[1] > _SMALL and not one[0].in_session, one[1])
            )
            self.account(largest, 0)
            largest.evict(
                f"it used {held / 2**20:.0f} MiB, more than any other, when the hub reached its limit of "
                f"{self._limit / 2**20:.0f} MiB (max_memory)"
            )
        self._wanted = 0
