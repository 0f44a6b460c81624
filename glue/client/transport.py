"""The transport of a peer's messages to a hub and back: the interface between a link and its socket.

A connection ends when the process at its other end does, or when data sent over it stays unacknowledged for
too long, because a cable was cut. The kernel detects both, so a peer that computes for hours stays connected.
A transport reconnects automatically.
"""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING, Final, Protocol
from urllib.parse import urlsplit

from glue.client.sockets import SocketTransport
from glue.client.target import OwnKey
from glue.errors import ConfigError
from glue.hub.config import check_url
from glue.system import network
from glue.wire.messages import MAX_BODY, MAX_HEADER, Message

if TYPE_CHECKING:
    from glue.client.libzmq import Context

_TIMEOUT: Final = 5.0
"""Seconds after which a connection attempt or unacknowledged data counts as failed."""


class Transport(Protocol):
    """A peer's end of the connection to a hub."""

    @property
    def connected(self) -> bool:
        """Whether there is a connection, as far as `receive_message` has noticed."""
        ...

    @property
    def connections(self) -> int:
        """Number of connections so far, including this one; the hub has to be greeted over each."""
        ...

    def notice_connections(self) -> None:
        """Bring `connected` and `connections` up to date."""
        ...

    def wait_at_most(self, seconds: float) -> None:
        """Set how long `receive_message` waits."""
        ...

    def spin_for(self, seconds: float) -> None:
        """Poll for a message for `seconds` before sleeping, if that is possible here."""
        ...

    def send_message(self, message: Message) -> bool:
        """Send a message; return False, having sent nothing, if there is no connection or no room."""
        ...

    def receive_message(self, max_body: int) -> Message | None:
        """Return the next message; None if none arrived in time, or as soon as there is a connection.

        Raises:
            UnknownKind: the message is of an unknown kind.
            RemoteProtocolError: it is malformed, or its body has more than `max_body` bytes.
        """
        ...

    def close(self, linger: float | None = None) -> None:
        """Close, giving the last messages at most `linger` seconds (by default one) to leave."""
        ...


def open_transport(url: str, context: Context | None = None, key: OwnKey | None = None) -> Transport:
    """Return a transport to the hub at `url`: a plain socket, or libzmq's if a context is given.

    If a key is given and PyNaCl is not installed, it is libzmq's as well.

    Args:
        url: address of the hub.
        context: the ZeroMQ context.
        key: the key by which the hub knows the peer, if any.

    Raises:
        ConfigError: the address is malformed, or the host's name does not resolve.
    """
    check_url(url)
    _check_host(url)
    max_frame = 2 * MAX_BODY + MAX_HEADER
    if context is None and (key is None or find_spec("nacl") is not None):
        return SocketTransport(url, _TIMEOUT, max_frame, key)
    from glue.client.libzmq import DealerTransport  # libzmq takes long to load, and few programs need it

    return DealerTransport(context, url, _TIMEOUT, max_frame, key)


def _check_host(url: str) -> None:
    """Refuse a host name that does not resolve, which would be looked up again and again."""
    parts = urlsplit(url)
    if parts.scheme == "tcp":
        host = parts.netloc.rpartition(":")[0].strip("[]")
        try:
            network.getaddrinfo(host, None)
        except (OSError, UnicodeError) as error:
            reason = error.strerror if isinstance(error, OSError) else "it is not a name of a host"
            raise ConfigError(f"cannot find the host {host!r} of {url}: {reason}; check the name") from None
