"""A DEALER of libzmq: a peer's end if a ZeroMQ context is given.

This is the only module that uses libzmq, which reconnects silently. Its monitor reports new connections, so
that a peer greets the hub once over each, and the reason for a failed handshake.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, Self

import zmq
from zmq.utils.monitor import recv_monitor_message

from glue.client.target import OwnKey, Target, needs_key, needs_no_key, unknown_key, wrong_hub_key
from glue.console import say
from glue.errors import ConfigError, GlueError, Refused
from glue.keys.certificates import KeyPair
from glue.keys.certificates import decode as decode_key
from glue.keys.certificates import encode as encode_key
from glue.system import threads
from glue.system.spinning import Spin
from glue.wire.codec import FROM_HUB, TO_HUB, decode, encode
from glue.wire.messages import MAX_FRAME, Message

Context = zmq.Context[zmq.Socket[bytes]]

# As plain ints: on the hot path, pyzmq's flags are expensive.
_MORE: Final = int(zmq.SNDMORE)
_AT_ONCE: Final = int(zmq.DONTWAIT)

_LINGER_MS: Final = 1000
"""Maximum time in milliseconds that a closing socket tries to deliver its last messages."""

_RELAY_TIMEOUT: Final = 5.0
"""Seconds after which a relay's connection counts as cut."""

_LOOK_MS: Final = 100
"""Maximum time in milliseconds in which a relay notices that it is to stop."""

_EVENTS: Final = (
    zmq.Event.HANDSHAKE_SUCCEEDED
    | zmq.Event.HANDSHAKE_FAILED_AUTH
    | zmq.Event.HANDSHAKE_FAILED_PROTOCOL
    | zmq.Event.HANDSHAKE_FAILED_NO_DETAIL
    | zmq.Event.DISCONNECTED
)


def new_pair() -> KeyPair:
    """Return a new pair of keys.

    Raises:
        ConfigError: this libzmq was built without CURVE.
    """
    if not zmq.has("curve"):
        raise ConfigError("this libzmq was built without CURVE: install the pyzmq of PyPI, which has it")
    public, secret = zmq.curve_keypair()
    return KeyPair(decode_key(public.decode()), decode_key(secret.decode()))


class DealerTransport:
    """A peer's end. It connects when the hub is there, and again whenever the connection breaks.

    Args:
        context: the ZeroMQ context; None to create one.
        url: address of the hub, as `glue.hub.config.check_url` accepts it.
        timeout: seconds after which a connection attempt or unacknowledged data counts as failed.
        key: the keys by which hub and peer know each other; None for no encryption.

    Attributes:
        connected: whether there is a connection, as far as `receive` has noticed.

    Raises:
        ConfigError: libzmq refuses the address.
    """

    def __init__(self, context: Context | None, url: str, timeout: float, key: OwnKey | None = None) -> None:
        self.connected: bool = False
        self._connections = 0
        self._url = url
        self._key = key
        self._wait_ms = -1
        self._own_context: Context | None = None
        if context is None:
            context = self._own_context = zmq.Context()
        self.socket: zmq.Socket[bytes] = context.socket(zmq.DEALER)
        milliseconds = max(1, int(timeout * 1000))
        for option, value in {
            zmq.LINGER: _LINGER_MS,
            zmq.SNDHWM: 4096,
            # No limit: the hub's heartbeats pile up while a player computes.
            zmq.RCVHWM: 0,
            zmq.MAXMSGSIZE: MAX_FRAME,
            zmq.TCP_MAXRT: milliseconds,
            zmq.CONNECT_TIMEOUT: milliseconds,
            zmq.RECONNECT_IVL: 50,
            zmq.RECONNECT_IVL_MAX: 1000,
            zmq.SNDTIMEO: 0,
            zmq.IPV6: int("[" in url),
        }.items():
            self.socket.setsockopt(option, value)
        if key is not None:
            self.socket.curve_serverkey = encode_key(key.hub).encode()
            self.socket.curve_publickey = encode_key(key.pair.public).encode()
            self.socket.curve_secretkey = encode_key(key.pair.secret).encode()
        self._monitor = self.socket.get_monitor_socket(_EVENTS)
        self._poller = zmq.Poller()
        self._poller.register(self.socket, zmq.POLLIN)
        self._poller.register(self._monitor, zmq.POLLIN)
        try:
            self.socket.connect(url)
        except zmq.ZMQError as error:
            self.close(0)
            raise ConfigError(f"cannot connect to {url}: {error.strerror}") from None

    def wait_at_most(self, seconds: float) -> None:
        """Set how long `receive` waits."""
        self._wait_ms = max(1, int(seconds * 1000))
        self.socket.setsockopt(zmq.RCVTIMEO, self._wait_ms)

    def spin_with(self, spin: Spin) -> None:
        """Do nothing: libzmq's own threads wait for messages."""

    def send_message(self, message: Message) -> bool:
        """Send a message, like `send`."""
        return self.send(encode(message, TO_HUB))

    def receive_message(self, max_body: int) -> Message | None:
        """Return the next message, like `receive`.

        Raises:
            UnknownKind: the message is of an unknown kind.
            RemoteProtocolError: it is malformed, or its body has more than `max_body` bytes.
        """
        frames = self.receive()
        return None if frames is None else decode(frames, FROM_HUB, max_body)

    def send(self, frames: Sequence[bytes]) -> bool:
        """Queue a message; return False if the queue is full."""
        try:
            for frame in frames[:-1]:
                self.socket.send(frame, _MORE)
            self.socket.send(frames[-1], 0)
        except zmq.Again:
            return False
        return True

    def receive(self) -> list[bytes] | None:
        """Return the next message; None if none arrived in time, or as soon as there is a connection."""
        flags = 0
        if not self.connected:
            self._poller.poll(self._wait_ms)
            self.notice_connections()
            if self.connected:
                return None
            flags = _AT_ONCE
        try:
            frame = self.socket.recv(flags, False)
            frames = [frame.bytes]
            while frame.more:
                frame = self.socket.recv(0, False)
                frames.append(frame.bytes)
            return frames
        except zmq.Again:
            self.notice_connections()
            return None

    @property
    def connections(self) -> int:
        """Number of connections so far; the hub has to be greeted over each.

        Raises:
            Refused: hub and peer cannot agree on how to authenticate, or the hub does not know the key.
        """
        self.notice_connections()
        return self._connections

    def notice_connections(self) -> None:
        """Bring `connected` and the number of connections up to date.

        Raises:
            Refused: as `connections`.
        """
        try:
            while True:
                message = recv_monitor_message(self._monitor, _AT_ONCE)
                event = message["event"]
                self.connected = event == zmq.Event.HANDSHAKE_SUCCEEDED
                self._connections += self.connected
                if not self.connected and event != zmq.Event.DISCONNECTED:
                    self._handshake_failed(event, message["value"])
        except zmq.Again:
            return

    def _handshake_failed(self, event: int, value: int) -> None:
        key = self._key
        if (
            event == zmq.Event.HANDSHAKE_FAILED_PROTOCOL
            and value == zmq.Event.PROTOCOL_ERROR_ZMTP_MECHANISM_MISMATCH
        ):
            raise needs_key(self._url) if key is None else needs_no_key(self._url)
        if key is None:
            return
        if event == zmq.Event.HANDSHAKE_FAILED_AUTH:
            unknown, wrong = unknown_key(key, self._url), wrong_hub_key(key, self._url)
            raise Refused(f"{unknown}; or perhaps {wrong}", settings=unknown.settings + wrong.settings)
        if event == zmq.Event.HANDSHAKE_FAILED_PROTOCOL and not self._connections:
            raise wrong_hub_key(key, self._url)

    def close(self, linger: float | None = None) -> None:
        """Close, giving the last messages at most `linger` seconds (by default one) to leave."""
        self.socket.disable_monitor()
        self._monitor.close(0)
        self.socket.close(_LINGER_MS if linger is None else int(linger * 1000))
        if self._own_context is not None:
            self._own_context.term()


class Relay:
    """An address on this machine, without encryption, that leads to a hub with keys.

    Programs whose library does not encrypt join the hub through it. A message is passed on as it came; when
    the connection to the hub breaks, the hub does not know the next one, and asks the program to greet it
    again. Only the last program that has connected gets messages.

    Args:
        url: the address, `ipc://PATH` in a folder that other users cannot enter.
        target: the hub, with the keys.

    Raises:
        ConfigError: the address cannot be listened on.
    """

    def __init__(self, url: str, target: Target) -> None:
        self._context: Context = zmq.Context()
        self._stop = threads.Event()
        self._local = self._context.socket(zmq.ROUTER)
        try:
            self._local.bind(url)
        except zmq.ZMQError as error:
            self._context.destroy(0)
            raise ConfigError(f"cannot listen at {url}: {error.strerror}") from None
        try:
            self._hub = DealerTransport(self._context, target.hub, _RELAY_TIMEOUT, target.key)
        except ConfigError:
            self._context.destroy(0)
            raise
        self._thread = threads.Thread(target=self._run, name="relay", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._stop.set()
        self._thread.join()
        self._hub.close(0)
        self._local.close(0)
        self._context.term()

    def _run(self) -> None:
        poller = zmq.Poller()
        for each in (self._local, self._hub.socket):
            poller.register(each, zmq.POLLIN)
        program = b""
        try:
            while not self._stop.is_set():
                ready = dict(poller.poll(_LOOK_MS))
                if self._local in ready:
                    program, *frames = self._local.recv_multipart()
                    self._hub.send(frames)
                if self._hub.socket in ready:
                    self._local.send_multipart([program, *self._hub.socket.recv_multipart()])
                if not ready:
                    self._hub.notice_connections()
        except GlueError as error:
            say(f"Error: {error}")
