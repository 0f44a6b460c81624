"""Connections to the page: their number, and the time until one has shown the token.

Any user of this machine can connect, and without limits could hold every descriptor of the server. A
connection is admitted by its first request with the cookie. Until then it has a few seconds, and is dropped
for a newer one if there are too many, so a browser gets in however many idle connections there are.
"""

from __future__ import annotations

import asyncio
import resource
import sys
from typing import Any, ClassVar, Final

from uvicorn.protocols.http.h11_impl import H11Protocol

from experiment_runner.view.guard import ADMIT

_SPARE: Final = 200
"""Descriptors for everything that is not a connection: stores, recordings, observers."""


def raise_descriptors() -> None:
    """Raise the limit of open files as far as this user may."""
    _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard, hard))


class Connection(H11Protocol):
    """A connection that uvicorn serves, with limits.

    Attributes:
        most: maximum number of connections; fewer if the limit of open files is low.
        share: maximum number of connections from one address that are not yet admitted.
        head_seconds: maximum time from the beginning of a connection until it is admitted.
    """

    most: ClassVar[int] = 1000
    share: ClassVar[int] = 250
    head_seconds: ClassVar[float] = 10.0

    def __init__(self, *arguments: Any, **settings: Any) -> None:
        super().__init__(*arguments, **settings)
        self.app_state: dict[str, Any] = {**self.app_state, ADMIT: self._admit}
        self._address = ""
        self._timer: asyncio.TimerHandle | None = self.loop.call_later(self.head_seconds, self._drop)

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Make room for the connection, or close it if all others are admitted."""
        self._address = self._address_of(transport)
        waiting = [other for other in self.connections if isinstance(other, Connection) and other._timer]
        same = [other for other in waiting if other._address == self._address]
        full = len(self.connections) >= min(self.most, _room())
        super().connection_made(transport)
        if len(same) >= self.share or full:
            oldest = min(same if len(same) >= self.share else waiting, key=_begun, default=self)
            oldest._drop()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget the connection."""
        self._admit()
        super().connection_lost(exc)

    def _admit(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None

    def _drop(self) -> None:
        self._admit()
        self.connections.discard(self)
        self.transport.abort()

    @staticmethod
    def _address_of(transport: asyncio.Transport) -> str:
        peer = transport.get_extra_info("peername")
        return str(peer[0]) if peer else ""


def _begun(connection: Connection) -> float:
    assert connection._timer is not None
    return connection._timer.when()


def _room() -> int:
    """Return the number of descriptors that this process has for connections."""
    soft, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    return sys.maxsize if soft == resource.RLIM_INFINITY else max(soft // 2, soft - _SPARE)
