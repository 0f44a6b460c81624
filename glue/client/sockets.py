"""A DEALER on one plain socket: the default connection of peers; and the choice between it and libzmq's.

A connection ends when the process at its other end does, or when data sent over it stays unacknowledged for
too long, because a cable was cut. The kernel detects both, so a peer that computes for hours stays connected.
A transport reconnects automatically.

libzmq's own sockets need an I/O thread, two wake-ups and some twenty system calls for a message; here two
system calls receive it and one sends the answer. On the wire there is no difference.
"""

from __future__ import annotations

from contextlib import suppress
from importlib.util import find_spec
from typing import TYPE_CHECKING, Final, Protocol
from urllib.parse import urlsplit

from glue.client.target import OwnKey, needs_key, needs_no_key, unknown_key, wrong_hub_key
from glue.errors import ConfigError, Refused, RemoteProtocolError
from glue.hub.config import check_url
from glue.system import clock, network
from glue.system.sockets import limit_silence, never_wait, probe_when_silent, unix_address, wait_for
from glue.system.spinning import Spin
from glue.wire import zmtp
from glue.wire.codec import UnknownKind
from glue.wire.messages import MAX_FRAME, Message
from glue.wire.steps import STEPS
from glue.wire.stream import Malformed, Stream

if TYPE_CHECKING:
    from glue.client.libzmq import Context
    from glue.wire.curve import CurveClient

_TIMEOUT: Final = 5.0
"""Seconds after which a connection attempt or unacknowledged data counts as failed."""

_CHUNK: Final = 65_536
"""Maximum number of bytes received at once; a larger buffer would cost a system call to allocate."""

_JOINED: Final = 65_536
"""Maximum size in bytes of a body that is copied behind its head: one buffer is cheaper to send than two."""

_TOGETHER_SECONDS: Final = 200e-6
"""Seconds for which the first answer to a step waits for others, to be sent in the same system call."""

_RETRY_SECONDS: Final = (0.05, 1.0)
"""Delay in seconds before connecting again: after the first failure, and the maximum."""

_LINGER_SECONDS: Final = 1.0
"""Maximum number of seconds that `close` waits for the hub to read the last messages."""


class Transport(Protocol):
    """A peer's end of the connection to a hub."""

    @property
    def connected(self) -> bool:
        """Whether there is a connection, as far as `receive_message` has noticed."""

    @property
    def connections(self) -> int:
        """Number of connections so far, including this one; the hub has to be greeted over each."""

    def wait_at_most(self, seconds: float) -> None:
        """Set how long `receive_message` waits."""

    def spin_with(self, spin: Spin) -> None:
        """Let `spin` decide whether to poll for a message before sleeping, if that is possible here."""

    def send_message(self, message: Message) -> bool:
        """Send a message; return False, having sent nothing, if there is no connection or no room."""

    def receive_message(self, max_body: int) -> Message | None:
        """Return the next message; None if none arrived in time, or as soon as there is a connection.

        Raises:
            UnknownKind: the message is of an unknown kind.
            RemoteProtocolError: it is malformed, or its body has more than `max_body` bytes.
        """

    def close(self, linger: float | None = None) -> None:
        """Close, giving the last messages at most `linger` seconds (by default one) to leave."""


class SocketTransport:
    """A connection to a hub, made again whenever it breaks.

    Args:
        url: `tcp://HOST:PORT` or `ipc://PATH`.
        timeout: seconds after which a connection attempt, handshake or unacknowledged data counts as failed.
        max_frame: maximum size of a frame, in bytes.
        key: the keys by which hub and peer know each other; None for no encryption.

    Attributes:
        connected: whether there is a connection with a complete handshake.
        connections: number of connections so far, including this one.

    Raises:
        ConfigError: a key is given, and PyNaCl is not installed.
    """

    def __init__(self, url: str, timeout: float, max_frame: int, key: OwnKey | None = None) -> None:
        self.connected: bool = False
        self.connections: int = 0
        self._url = url
        self._timeout = timeout
        self._max_frame = max_frame
        self._wait = timeout
        self._socket: network.socket | None = None  # connected or connecting
        self._poller = network.poll()  # waits for data
        self._key = key
        self._curve: CurveClient | None = None
        self._stream = self._new_stream()
        self._joined: list[bytes | bytearray] = []  # answers to steps, which wait for others
        self._joined_until = 0.0
        self._greeted = False
        self._deadline = 0.0  # of the handshake
        self._retry = _RETRY_SECONDS[0]
        self._retry_at = 0.0
        self._spin: Spin | None = None

    def wait_at_most(self, seconds: float) -> None:
        """Set how long `receive_message` waits, in seconds."""
        self._wait = seconds

    def spin_with(self, spin: Spin) -> None:
        """Let `spin` decide whether to poll for a message before sleeping."""
        self._spin = spin

    def send_message(self, message: Message) -> bool:
        """Send a message; return False, having sent nothing, if there is no connection.

        The answer to a step is sent with the answers to the steps received together with it, unless these
        take long.
        """
        if not self.connected:
            return False
        head, body = self._stream.encode(message)
        if len(body) <= _JOINED:
            data = head + body if body else head
            if self._joined or (not self._stream.empty and message.kind in STEPS):
                return self._join(data, message.kind in STEPS)
            return self._send(data)
        connected = self._socket
        assert connected is not None
        try:
            self._send_joined()
            sent = connected.sendmsg((head, body))
        except BlockingIOError:
            sent = 0
        except OSError:
            self._fail()
            return False
        rest = [memoryview(head)[sent:], memoryview(body)[max(0, sent - len(head)) :]]
        return all(self._send_rest(connected, part) for part in rest)

    def _join(self, data: bytes | bytearray, may_wait: bool) -> bool:
        """Send a message after those that wait; it may wait, too, if more messages need an answer."""
        now = clock.monotonic()
        if not self._joined:
            self._joined_until = now + _TOGETHER_SECONDS
        self._joined.append(data)
        if may_wait and not self._stream.empty and now < self._joined_until:
            return True
        return self._send_joined()

    def _send_joined(self) -> bool:
        data = b"".join(self._joined)
        self._joined.clear()
        return self._send(data) if data else self.connected

    def receive_message(self, max_body: int) -> Message | None:
        """Return the next message; None if none arrived in time, or as soon as there is a connection.

        Raises:
            Refused: hub and peer cannot agree on how to authenticate, or one does not know the other's key.
            UnknownKind: the message is of an unknown kind.
            RemoteProtocolError: it is malformed, or its body has more than `max_body` bytes.
        """
        while True:
            stream = self._stream
            stream.max_body = max_body
            if stream.empty and self.connected:
                data = self._receive_data()
                if data is None:
                    return None
                stream.receive_data(data)
            try:
                event = stream.next_event()
            except (Malformed, UnknownKind):
                raise
            except RemoteProtocolError as error:
                refusal = self._refusal(error)
                self._fail()
                if refusal is not None:
                    raise refusal from None
                return None
            if type(event) is Message:
                return event
            if not self.connected and stream.ready:
                self._begin()
                if event:
                    self._send(event)
                return None
            if event is not None:
                self._send(event)
            else:
                data = self._receive_data() if self.connected else self._shake_hands()
                if data is None:
                    return None
                stream.receive_data(data)

    def _refusal(self, error: RemoteProtocolError) -> Refused | None:
        """Return the error to raise if connecting again after `error` would be useless, else None.

        A handshake that is cut ends without an error. A handshake that fails otherwise will fail again,
        unless an earlier one has succeeded: then the cause is different, and may pass.
        """
        key, curve = self._key, self._curve
        if isinstance(error, zmtp.OtherMechanism):
            return needs_key(self._url) if key is None else needs_no_key(self._url)
        if key is None or curve is None or self._stream.ready:
            return None
        if isinstance(error, zmtp.HandshakeEnded):
            return unknown_key(key, self._url) if curve.server_known else wrong_hub_key(key, self._url)
        return wrong_hub_key(key, self._url) if not self.connections else None

    def close(self, linger: float | None = None) -> None:
        """Close, giving the hub at most `linger` seconds (by default one) to read the last messages."""
        if self.connected:
            self._send_joined()
        connected, self._socket = self._socket, None
        linger = _LINGER_SECONDS if linger is None else linger
        if connected is None:
            return
        with connected:
            # Closing with unread data resets the connection, which discards data that the hub has not read.
            if linger and self.connected:
                deadline = clock.monotonic() + linger
                with suppress(OSError):
                    connected.shutdown(network.SHUT_WR)
                    while (left := deadline - clock.monotonic()) > 0:
                        connected.settimeout(left)
                        if not connected.recv(_CHUNK):
                            break

    def _receive_data(self) -> bytes | None:
        if self._joined and not self._send_joined():
            return None
        data = None if self._spin is None else self._spin.until_found(self._read)
        # A thread blocked in `recv` is also woken when the other end has read: `poll` waits for data only.
        if data is None and self._poller.poll(self._wait * 1000):
            data = self._read()
        if data == b"":
            self._fail()
            return None
        return data

    def _read(self) -> bytes | None:
        """Return the data received: None if none is available, empty at the end."""
        assert self._socket is not None
        try:
            return self._socket.recv(_CHUNK)
        except BlockingIOError:
            return None
        except OSError:
            return b""

    def _send(self, data: bytes | bytearray) -> bool:
        connected = self._socket
        assert connected is not None
        try:
            sent = connected.send(data)
        except BlockingIOError:
            sent = 0
        except OSError:
            self._fail()
            return False
        return sent == len(data) or self._send_rest(connected, memoryview(data)[sent:])

    def _send_rest(self, connected: network.socket, rest: memoryview) -> bool:
        """Send data that the hub has no room for yet; read meanwhile, as the hub may be blocked by us."""
        poller = network.poll()
        while rest:
            crowded = self._stream.buffered > 2 * self._max_frame
            poller.register(connected, network.POLLOUT if crowded else network.POLLIN | network.POLLOUT)
            _, events = poller.poll()[0]
            try:
                if events & network.POLLOUT:
                    rest = rest[connected.send(rest) :]
                else:
                    data = connected.recv(_CHUNK)
                    if not data:
                        raise ConnectionResetError
                    self._stream.receive_data(data)
            except BlockingIOError:
                continue
            except OSError:
                self._fail()
                return False
        return True

    # Making a connection, in steps that wait no longer than `receive_message` may.

    def _shake_hands(self) -> bytes | None:
        """Take the next step towards a connection; return the data received, or None if it has to wait."""
        now = clock.monotonic()
        if self._socket is None:
            if now < self._retry_at:
                clock.sleep(min(self._retry_at - now, self._wait))
                return None
            self._deadline = now + self._timeout
            self._greeted = False
        try:
            if self._socket is None:
                self._socket = _connect(self._url)
            left = max(0.0, self._deadline - now)
            events = network.POLLIN if self._greeted else network.POLLOUT
            if not wait_for(self._socket, events, min(left, self._wait)):
                if left <= self._wait:
                    self._fail()
                return None
            if self._greeted:
                data = self._socket.recv(_CHUNK)
                if not data:
                    raise ConnectionResetError
                return data
            self._socket.send(zmtp.GREETING if self._curve is None else zmtp.CURVE_CLIENT_GREETING)
            self._greeted = True
            return b""
        except OSError:
            self._fail()
            return None

    def _begin(self) -> None:
        """Start using a connection whose handshake is complete."""
        assert self._socket is not None
        self.connected = True
        self.connections += 1
        self._retry = _RETRY_SECONDS[0]
        self._poller = network.poll()
        self._poller.register(self._socket, network.POLLIN)
        probe_when_silent(self._socket, self._timeout)
        limit_silence(self._socket, self._timeout)

    def _new_stream(self) -> Stream:
        if self._key is not None:
            from glue.wire.curve import CurveClient  # needs an extra

            self._curve = CurveClient(self._key.pair.public, self._key.pair.secret, self._key.hub)
        return Stream(zmtp.DEALER, self._max_frame, mechanism=self._curve)

    def _fail(self) -> None:
        """Close a failed connection, and connect again in a while."""
        if self._socket is not None:
            self._socket.close()
            self._socket = None
        self.connected = False
        self._joined.clear()
        self._stream = self._new_stream()
        self._retry_at = clock.monotonic() + self._retry
        self._retry = min(2 * self._retry, _RETRY_SECONDS[1])


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
    if context is None and (key is None or find_spec("nacl") is not None):
        return SocketTransport(url, _TIMEOUT, MAX_FRAME, key)
    from glue.client.libzmq import DealerTransport  # libzmq takes long to load, and few programs need it

    return DealerTransport(context, url, _TIMEOUT, key)


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


def _connect(url: str) -> network.socket:
    """Return a socket that is connecting to a hub.

    Raises:
        OSError: connecting failed.
    """
    scheme, _, rest = url.partition("://")
    if scheme == "ipc":
        family = network.AF_UNIX
        address: tuple[str | int, ...] | str | tuple[int, bytes] = unix_address(rest)
    else:
        host, _, port = rest.rpartition(":")
        family = network.AF_INET6 if host.startswith("[") else network.AF_INET
        address = network.getaddrinfo(host.strip("[]"), int(port), family, network.SOCK_STREAM)[0][4]
    connecting = network.socket(family)
    try:
        never_wait(connecting)
        connecting.connect(address)
    except BlockingIOError:
        pass  # under way
    except OSError:
        connecting.close()
        raise
    return connecting
