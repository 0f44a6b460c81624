"""The hub's end of ZeroMQ: to its peers a ROUTER socket, here plain sockets in the hub's loop.

libzmq's own ROUTER is not used: it keeps all of a message that never ends, it aborts the process when a
connection breaks in the middle of a flood (libzmq's issue 4364), and its threads double the time of a step.

A connection has to join a session soon after it is made. In a turn of the loop, one message is read from it
for each of its sessions, so that sessions share the hub fairly. If a message was out of turn, the next one
waits in the loop's queue. The hub reads from a peer no faster than the peer reads what it is sent.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Any, Final

from glue.errors import RemoteProtocolError
from glue.hub.channel import Channel
from glue.hub.config import Bind, HubConfig, Keys
from glue.hub.io.connection import Connection, Owner, take_leave
from glue.hub.io.listener import Listener, OpenAddress
from glue.hub.io.log import Log
from glue.hub.io.loop import Loop
from glue.hub.sessions import Sessions
from glue.system import clock, network
from glue.system.sockets import limit_silence
from glue.wire import zmtp
from glue.wire.codec import UnknownKind
from glue.wire.messages import MAX_HEADER, OBSERVING, Kind, Message, Role
from glue.wire.steps import STEPS
from glue.wire.stream import Malformed, Stream

MAX_UNSENT: Final = 64 * 2**20
"""Maximum number of bytes waiting to be sent to one peer; with more, the peer counts as unreachable."""

MAX_WITHOUT_SESSION: Final = 256
"""Maximum number of connections that take part in no session; one more, and the oldest is dropped."""

_BASE: Final = 6144
"""Bytes that a connection uses at most besides what it has received and not sent."""

_PEER: Final = 4608
"""Bytes that a peer in one session uses at most: its names, and the formats of its steps."""

_MAX_COPIED: Final = 65_536
"""Maximum size of a body that is sent together with its head, in bytes; copying more costs memory."""

_HELLO: Final = Kind.HELLO


class _SocketChannel(Owner):
    """One connection, and the peer at its other end; a channel of the sessions.

    Attributes:
        connection: the connection.
    """

    def __init__(
        self,
        channels: Channels,
        connection: Connection,
        bind: Bind,
        max_body: int,
        mechanism: zmtp.Mechanism | None = None,
    ) -> None:
        self.connection = connection
        self._channels = channels
        self._loop = channels.loop
        self._sessions = channels.sessions
        self._bind = bind
        # A frame that is only slightly too long is read, and answered with an error that says so.
        self._stream = Stream(zmtp.ROUTER, max_body + MAX_HEADER, max_body, mechanism)
        self._held = 0
        self._dismissed = False
        connection.owner = self

    def admits(self, role: Role, session: str) -> bool:
        """Return whether a peer that connects here may join `session` as `role`."""
        return self._bind.admits(role, session)

    def deliver(self, message: Message) -> bool:
        """Send `message`; return False, having sent nothing, if the peer is gone or does not read."""
        connection = self.connection
        if connection.closed or self._dismissed or connection.unsent > MAX_UNSENT:
            return False
        kind = message[0]
        if connection.unsent and kind in OBSERVING:
            return False  # an observer that has not read the previous messages misses this one
        size = len(message[4])
        if size > _MAX_COPIED and self._stream.copies and not self._sessions.memory.make_room(size):
            return False
        data, body = self._stream.encode(message)
        if body and len(body) <= _MAX_COPIED:
            data += body
            body = b""
        joined = self._channels.joined
        is_step = kind in STEPS
        if is_step and joined is not None and not body:
            joined.setdefault(self, []).append(data)
            return True
        if joined:
            self.send_joined()
        connection.send(data)
        if body:
            connection.send(body)
        if is_step:
            self._loop.expect(connection)
        if connection.unsent:
            self._account_for_data()
        return True

    def send_joined(self) -> None:
        """Send the steps that were joined for this peer, if there are any."""
        joined = self._channels.joined
        steps = joined.pop(self, None) if joined else None
        if steps is not None and not self.connection.closed:
            self.connection.send(b"".join(steps))
            self._loop.expect(self.connection)
            if self.connection.unsent:
                self._account_for_data()

    @property
    def in_session(self) -> bool:
        """Whether it takes part in a session."""
        return self._sessions.num_sessions(self) > 0

    def forget(self, session: str) -> None:
        """Forget what was learned of the messages of a session, in which it takes part no longer."""
        self._stream.forget(session)
        self.account()

    def evict(self, why: str) -> None:
        """Drop the connection, which uses too much memory, or its peers if it is gone already."""
        if self._channels.has(self):
            self._channels.drop(self, why)
        else:
            self._sessions.lose(self, why, clock.monotonic())

    def _account_for_data(self) -> None:
        """Account for data that is kept: incomplete messages, and messages that the peer has not read."""
        held = (self._stream.kept + self.connection.unsent) * 9 // 8  # buffers grow by an eighth
        if held != self._held:
            self._held = held
            self.account()

    def account(self) -> None:
        """Account for the connection until it is dropped, and for its peers, which may outlast it."""
        used = _BASE + self._held if self._channels.has(self) else 0
        self._sessions.memory.account(self, used + _PEER * self._sessions.num_sessions(self))

    def ready(self, now: float) -> None:
        """Act on messages received, at most one for each session."""
        connection, memory = self.connection, self._sessions.memory
        data = connection.receive()
        if data:
            self._stream.receive_data(data)
        try:
            all_read = self._act(now)
        except RemoteProtocolError as error:
            self._reject(error, now)
            all_read = self._stream.empty
        finally:
            if self._channels.joined is not None:
                self._channels.send_joined()
        if self._dismissed:
            return
        if connection.unsent:
            connection.read(False)  # the turn after everything has been sent resumes here
        elif not all_read:
            connection.read(False)
            connection.later()
        elif data == b"":
            self._channels.drop(self, None)
            return
        elif not connection.reading:
            connection.read(True)
        if connection.unsent or self._held or not self._stream.empty:
            self._account_for_data()
        if memory.exceeded:
            memory.enforce()

    def _act(self, now: float) -> bool:
        """Act on at most one message for each session; return whether all that was received has been read."""
        connection, stream, sessions = self.connection, self._stream, self._sessions
        left = sessions.num_sessions(self) or 1
        while left and not connection.unsent:
            event = stream.next_event()
            if event is None:
                return True
            left -= 1
            if type(event) is not Message:
                connection.in_turn = False
                connection.send(event)
                break
            if left and not stream.empty:
                self._channels.join()
            connection.in_turn = sessions.receive(self, event, now)
            if event[0] is _HELLO:
                self._channels.greeted(self, event)
            if not connection.in_turn:
                break
        return stream.empty

    def _reject(self, error: RemoteProtocolError, now: float) -> None:
        """Act on bytes that are not a message; keep a connection on which others may follow."""
        self.connection.in_turn = False
        in_session = self.in_session
        if isinstance(error, Malformed | UnknownKind):
            self._sessions.malformed(self, error, now)
            if in_session or isinstance(error, UnknownKind):
                return
        elif isinstance(error, zmtp.HandshakeRefused):
            self.connection.send(error.farewell)
        self._dismiss(str(error))

    def failed(self, now: float) -> None:
        """Forget the connection, which was reset after an error of the hub."""
        self._channels.drop(self, None)
        self._sessions.lose(self, "was dropped after an error of the hub", now)

    def close(self) -> None:
        """Close the connection, and release everything that is kept for it; its peers may remain."""
        self._stream = Stream(zmtp.ROUTER, 0)
        self.connection.close()

    def _dismiss(self, why: str) -> None:
        """End the connection once the peer has received all messages so far; send it no more."""
        self._dismissed = True
        self._stream = Stream(zmtp.ROUTER, 0)
        self._account_for_data()
        self._channels.complain(self, why)
        self.connection.in_turn = False
        self.connection.finish()


class _KeyedChannel(_SocketChannel):
    """A connection at an address with keys: it uses CURVE, and may join where both key and address allow."""

    def __init__(
        self, channels: Channels, connection: Connection, bind: Bind, max_body: int, keys: Keys
    ) -> None:
        from glue.wire.curve import CurveServer  # needs an extra

        self._keys = keys
        self._curve = CurveServer(keys.secret, lambda client: client in self._keys.permits)
        super().__init__(channels, connection, bind, max_body, self._curve)

    def admits(self, role: Role, session: str) -> bool:
        """Return whether the owner of the key may join `session` as `role` here."""
        permit = self._keys.permits[self._curve.client]
        return super().admits(role, session) and permit.admits(role, session)

    def renew(self, keys: Keys) -> str | None:
        """Take the hub's new keys; return why the connection has to end, or None."""
        before, self._keys = self._keys, keys
        client = self._curve.client
        if keys.secret != before.secret:
            return "the hub has a new key"
        if not client or keys.permits.get(client) == before.permits[client]:
            return None
        name = before.permits[client].name
        return f"the key of {name!r} was {'changed' if client in keys.permits else 'removed'}"


class Channels:
    """All connections of a hub's peers: accepts connections, and drops those that misbehave.

    Args:
        loop: the loop it runs in, not yet running.
        config: times and limits.
        addresses: open addresses for peers; closed by the caller.
        sessions: acts on the messages received.
        log: takes a line for people about each connection that is dropped.

    Attributes:
        loop: as given.
        sessions: as given.
        joined: while several messages are acted on, the resulting steps, by channel; otherwise None. Sent
            one by one, the first step would wake the peer to find only one call waiting.
    """

    def __init__(
        self,
        loop: Loop,
        config: HubConfig,
        addresses: Sequence[tuple[Bind, OpenAddress]],
        sessions: Sessions,
        log: Log,
    ) -> None:
        self.loop = loop
        self.sessions = sessions
        self.joined: dict[_SocketChannel, list[bytes | bytearray]] | None = None
        self._config = config
        self._log = log
        self._complaint = ""
        self._keys: Keys | None = None  # keys that have replaced those of the addresses
        self._open: dict[_SocketChannel, None] = {}  # in the order in which they were accepted
        self._without_session: dict[_SocketChannel, float] = {}
        """Channels that take part in no session, the oldest first, and since when."""
        self._listeners = [
            Listener(loop, address, partial(self._accept, bind), log) for bind, address in addresses
        ]
        loop.on_tick(self._tick)
        sessions.on_leave(self._left)

    def close(self) -> None:
        """Close, after a short wait for the last messages to be read."""
        for listener in self._listeners:
            listener.stop()
        for channel in self._open:
            channel.connection.finish()
        take_leave(lambda: [channel.connection for channel in self._open], self._config.farewell)
        for channel in self._open:
            channel.close()

    def renew(self, keys: Keys, now: float) -> None:
        """Replace the keys of every address that has any; drop connections whose admission has changed."""
        self._keys = keys
        for channel in list(self._open):
            if isinstance(channel, _KeyedChannel) and (why := channel.renew(keys)):
                self.drop(channel, why)
                self.sessions.lose(channel, f"was dropped: {why}", now)

    def join(self) -> None:
        """Hold the steps that are delivered from now on, to be sent together at the next `send_joined`."""
        if self.joined is None:
            self.joined = {}

    def send_joined(self) -> None:
        """Send the steps that were joined."""
        for channel in list(self.joined or ()):
            channel.send_joined()
        self.joined = None

    def greeted(self, channel: _SocketChannel, hello: Message) -> None:
        """Note that a HELLO of a connection was answered."""
        channel.account()
        if not channel.in_session:
            return
        self._without_session.pop(channel, None)
        capabilities: Any = hello.scalars[-1]
        if "batch" in capabilities:
            self.loop.spin_longer()

    def drop(self, channel: _SocketChannel, why: str | None) -> None:
        """Close a connection; `why`, if it should be logged, completes a sentence about it."""
        if why is not None:
            self.complain(channel, why)
        self._open.pop(channel, None)
        self._without_session.pop(channel, None)
        channel.close()
        channel.account()
        self._log.connection(f"{channel.connection.name} is gone")

    def has(self, channel: _SocketChannel) -> bool:
        """Return whether a connection has not been dropped."""
        return channel in self._open

    def complain(self, channel: _SocketChannel, why: str) -> None:
        """Log why a connection is dropped, unless the reason is the same as the last time."""
        # A peer with the wrong kind of socket connects again and again.
        if why != self._complaint:
            self._complaint = why
            self._log(f"{channel.connection.name} was dropped: {why}")

    def _accept(self, bind: Bind, connected: network.socket, name: str, now: float) -> None:
        while len(self._without_session) >= MAX_WITHOUT_SESSION:
            oldest = next(iter(self._without_session))
            self.drop(oldest, f"{MAX_WITHOUT_SESSION} newer connections have not joined a session either")
        limit_silence(connected, self._config.timeout)
        connection = Connection(self.loop, connected, name, self._config.heartbeat)
        max_body = self._config.max_body
        if bind.keys is None:
            channel = _SocketChannel(self, connection, bind, max_body)
            connection.send(zmtp.GREETING)
        else:
            channel = _KeyedChannel(self, connection, bind, max_body, self._keys or bind.keys)
            connection.send(zmtp.CURVE_GREETING)
        self._open[channel] = None
        self._without_session[channel] = now
        channel.account()
        self._log.connection(f"{name} connected")

    def _left(self, channel: Channel, session: str) -> None:
        if isinstance(channel, _SocketChannel):
            channel.forget(session)

    def _tick(self, now: float) -> None:
        for channel in list(self._open):
            if channel.in_session:
                self._without_session.pop(channel, None)
            elif now - self._without_session.setdefault(channel, now) >= self._config.greeting:
                self.drop(channel, None)
