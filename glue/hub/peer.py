"""The peers of a session, the routes to them, and the hub's interface for sessions."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol

from glue.hub.memory import Memory
from glue.wire.messages import Message, Role

if TYPE_CHECKING:
    from glue.hub.session import Session


class Route(Protocol):
    """A connection over which messages are received and sent."""

    def deliver(self, message: Message) -> bool:
        """Send `message`; return False, having sent nothing, if the other side is gone or does not read."""
        ...

    def admits(self, role: Role, session: str) -> bool:
        """Return whether a peer of this route may join `session` as `role`; see `glue.hub.config.Bind`."""
        ...


class Peer:
    """The program that fills a role, and the route to it.

    `name` is its name in error messages; `label` adds its language and library, for notices and the log.
    """

    __slots__ = (
        "capabilities",
        "confirmed",
        "instance",
        "label",
        "name",
        "role",
        "route",
        "session",
        "unreachable_since",
    )

    def __init__(
        self,
        session: Session,
        role: Role,
        route: Route,
        instance: bytes,
        name: str,
        label: str,
        capabilities: frozenset[str],
        confirmed: bool,
    ) -> None:
        self.session: Session = session
        self.role: Role = role
        self.route: Route = route
        self.instance: bytes = instance
        self.name: str = name
        self.label: str = label
        self.capabilities: frozenset[str] = capabilities
        self.confirmed: bool = confirmed
        self.unreachable_since: float | None = None


class Board(Protocol):
    """The hub's interface for sessions; see `glue.hub.sessions.Switchboard`."""

    memory: Memory
    log: Callable[[str], None]

    def deliver(self, peer: Peer, message: Message) -> None:
        """Send `message` to `peer`, or note that the peer cannot be reached."""
        ...

    def end(self, session: Session, why: str) -> None:
        """End a session: say goodbye to all its peers."""
        ...

    def dismiss(self, player: Peer, why: str) -> None:
        """Say goodbye to a failed player, and continue without it; `why` completes a sentence about it."""
        ...
