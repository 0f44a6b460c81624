"""A simulated network: stream sockets between processes of a world, as glue/system/network.py offers them.

Bytes arrive in order and once, or not at all, as with TCP. The faults decide what goes wrong:
`on_send` is called for each system call that sends."""

from __future__ import annotations

import errno
import socket as real
from collections import deque
from collections.abc import Callable, Iterable
from functools import partial
from select import POLLERR, POLLHUP, POLLIN, POLLOUT
from typing import Any, Final

from greenlet import getcurrent

from tests.simulation.world import Process, World

CAPACITY: Final = 100_000
"""Bytes on their way or unread in one direction of a connection."""


class Socket:
    """One end of a connection, or a socket that listens.

    Attributes:
        peer: the other end; None before there is one.
        inbox: bytes that have arrived and are unread.
        sent: number of bytes sent over it.
        capacity: maximum number of bytes on their way to the peer or unread there.
        dribble: number of further reads that return a single byte.
        clogged_until: virtual time before which nothing that is sent over it arrives.
        queue: data on its way to the peer.
        lost: whether all further data is lost.
        judged: whether the other end has to read exactly the messages that were sent here.
    """

    def __init__(self, net: Net, process: Process, family: int = real.AF_INET) -> None:
        net.descriptors += 1
        self.fd = net.descriptors
        self.net = net
        self.world = net.world
        self.process = process
        self.family = family
        self.address: Any = ("127.0.0.1", 40_000 + self.fd)
        self.peer: Socket | None = None
        self.backlog: list[Socket] | None = None
        self.inbox = bytearray()
        self.eof = False
        self.error = 0
        self.closed = False
        self.blocking = True
        self.timeout: float | None = None
        self.options: dict[int, int] = {}
        self.shut = False
        self.flying = 0
        self.sent = 0
        self.capacity = CAPACITY
        self.dribble = 0
        self.clogged_until = 0.0
        self.lost = False
        self.judged = True
        self.queue: deque[bytes | str] = deque()
        self.arrival = 0.0
        self.latency = 0.0001
        self.reader: Any = None
        self.pollers: list[Poller] = []
        process.connections[self.fd] = self

    # The calls of the standard library's sockets.

    def __enter__(self) -> Socket:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()

    def fileno(self) -> int:
        return -1 if self.closed else self.fd

    def setblocking(self, flag: bool) -> None:
        self.blocking, self.timeout = flag, None

    def settimeout(self, seconds: float) -> None:
        self.blocking, self.timeout = True, seconds

    def setsockopt(self, level: int, option: int, value: int | bytes) -> None:
        self._check()
        self.options[option] = value if isinstance(value, int) else 1

    def getsockopt(self, level: int, option: int) -> int:
        self._check()
        error, self.error = self.error, 0
        if error:
            self.eof = True
        return error

    def getsockname(self) -> Any:
        return self.address

    def connect(self, address: Any) -> None:
        self._check()
        listening = self.net.listening.get(address[1])
        if listening is None or listening.closed:
            raise ConnectionRefusedError(errno.ECONNREFUSED, "refused")
        self.net.connect(self, listening)

    def accept(self) -> tuple[Socket, Any]:
        self._check()
        if not self.backlog:
            raise BlockingIOError
        accepted = self.backlog.pop(0)
        return accepted, accepted.peer.address if accepted.peer else ("127.0.0.1", 1)

    def send(self, data: Any) -> int:
        self._check()
        if self.error:
            self._raise()
        peer = self.peer
        if peer is None:
            raise BlockingIOError
        if self.shut or (peer.closed and self.family == real.AF_UNIX):
            raise BrokenPipeError(errno.EPIPE, "broken pipe")
        room = self.room()
        if room <= 0:
            raise BlockingIOError
        data = bytes(data[:room]) if len(data) > room else bytes(data)
        self.net.carry(self, data)
        return len(data)

    def sendmsg(self, parts: Iterable[bytes]) -> int:
        return self.send(b"".join(parts))

    def recv(self, size: int) -> bytes:
        while True:
            self._check()
            if self.inbox:
                if self.dribble:
                    self.dribble -= 1
                    size = 1
                data = bytes(self.inbox[:size])
                del self.inbox[:size]
                if self.peer is not None and self.peer.pollers:
                    self.peer.notify()  # there is room again
                return data
            if self.error:
                self._raise()
            if self.eof:
                return b""
            if not self.blocking:
                raise BlockingIOError
            self.reader = getcurrent()
            began = self.world.now
            self.world.block(self.timeout)
            self.reader = None
            if (
                self.timeout is not None
                and not (self.inbox or self.eof or self.error)
                and self.world.now >= began + self.timeout
            ):
                raise BlockingIOError

    def shutdown(self, how: int) -> None:
        self._check()
        if self.peer is None or self.error:
            raise OSError(errno.ENOTCONN, "not connected")
        if not self.shut:
            self.shut = True
            self.net.transmit(self, "end")
        if how == real.SHUT_RDWR:
            self.eof = True
            self.notify()

    def close(self) -> None:
        if self.closed:
            return
        self.closed = True
        self.process.connections.pop(self.fd, None)
        if self.backlog is not None:
            self.net.listening.pop(self.address[1], None)
            for waiting in self.backlog:
                waiting.close()
            return
        peer = self.peer
        if peer is not None and not peer.closed:
            if self.inbox or real.SO_LINGER in self.options:
                self.net.transmit(self, "reset")
            elif not self.shut:
                self.shut = True
                self.net.transmit(self, "end")

    # The simulation's side.

    def room(self) -> int:
        """Return the number of bytes that can be sent now."""
        return self.capacity - self.flying - (len(self.peer.inbox) if self.peer is not None else 0)

    def events(self) -> int:
        """Return the events that `poll` would report."""
        if self.closed:
            return POLLHUP
        if self.backlog is not None:
            return POLLIN if self.backlog else 0
        found = POLLIN if self.inbox or self.eof or self.error else 0
        if self.error:
            found |= POLLERR | POLLHUP | POLLOUT
        elif self.peer is not None and (self.room() > 0 or self.shut):
            found |= POLLOUT
        if self.eof and self.shut:
            found |= POLLHUP
        return found

    def notify(self) -> None:
        """Wake the thread and the pollers that wait for this socket."""
        if self.reader is not None:
            self.world.wake(self.reader)
        for poller in self.pollers:
            poller.notify(self.fd)

    def _check(self) -> None:
        if self.closed or not self.process.alive:
            raise OSError(errno.EBADF, "closed")

    def _raise(self) -> None:
        error, self.error = self.error, 0
        self.eof = True
        raise OSError(error, "simulated")


class Poller:
    """Like `select.epoll`; `PollerMs` is like `select.poll`, with milliseconds."""

    def __init__(self, net: Net) -> None:
        self.net = net
        self._interest: dict[int, tuple[Socket, int]] = {}
        self._hot: dict[int, None] = {}  # descriptors with news, or ready before
        self._waiting: Any = None

    def register(self, watched: Any, events: int) -> None:
        found = watched if isinstance(watched, Socket) else self._find(watched)
        if self not in found.pollers:
            found.pollers.append(self)
        self._interest[found.fd] = found, events
        self._hot[found.fd] = None

    modify = register

    def _find(self, fd: int) -> Socket:
        current: Any = getcurrent()
        found: Socket | None = current.process.connections.get(fd)
        if found is None:
            raise OSError(errno.EBADF, f"no descriptor {fd}")
        return found

    def unregister(self, fd: int) -> None:
        found, _ = self._interest.pop(fd)
        if self in found.pollers:
            found.pollers.remove(self)

    def notify(self, fd: int) -> None:
        self._hot[fd] = None
        if self._waiting is not None:
            self.net.world.wake(self._waiting)

    def _ready(self) -> list[tuple[int, int]]:
        ready = []
        for fd in list(self._hot):
            watched, interest = self._interest.get(fd, (None, 0))
            if watched is None or watched.closed:
                self._interest.pop(fd, None)  # as the system forgets a descriptor that was closed
                del self._hot[fd]
                continue
            events = watched.events() & (interest | POLLERR | POLLHUP)
            if events:
                ready.append((fd, events))
            else:
                del self._hot[fd]
        return ready

    def poll(self, seconds: float | None = None) -> list[tuple[int, int]]:
        world = self.net.world
        ready = self._ready()
        if ready or (seconds is not None and seconds <= 0):
            return ready
        until = None if seconds is None else world.now + seconds
        while not ready and (until is None or world.now < until):
            self._waiting = getcurrent()
            world.block(None if until is None else until - world.now)
            self._waiting = None
            ready = self._ready()
        return ready

    def close(self) -> None:
        for watched, _ in self._interest.values():
            if self in watched.pollers:
                watched.pollers.remove(self)
        self._interest.clear()


class PollerMs(Poller):
    """Like `select.poll`."""

    def poll(self, milliseconds: float | None = None) -> list[tuple[int, int]]:
        for watched, _ in self._interest.values():
            if self not in watched.pollers:
                watched.pollers.append(self)
                self._hot[watched.fd] = None
        found = super().poll(None if milliseconds is None else milliseconds / 1000)
        for watched, _ in self._interest.values():
            if self in watched.pollers:
                watched.pollers.remove(self)  # it may not be polled again
        return found


class Net:
    """All sockets of a world.

    Args:
        world: the world.
        on_send: called with the socket and the bytes of each system call that sends; returns how many
            seconds they are late, or None if it has dealt with them itself.

    Attributes:
        sends: number of system calls that sent something.
    """

    def __init__(self, world: World) -> None:
        self.world = world
        self.descriptors = 10
        self.listening: dict[int, Socket] = {}
        self.sends = 0
        self.on_send: Callable[[Socket, bytes], float | None] = lambda sender, data: 0.0

    def functions(self) -> dict[str, Any]:
        """Return the functions that replace those of the network."""
        net = self

        def process() -> Process:
            current: Any = getcurrent()
            found: Process = current.process
            return found

        def socket(family: int = real.AF_INET, *kind: int) -> Socket:
            return Socket(net, process(), family)

        def create_server(address: Any, **how: Any) -> Socket:
            port = address[1]
            if net.listening.get(port) is not None:
                raise OSError(errno.EADDRINUSE, "in use")
            listening = Socket(net, process())
            listening.address = ("127.0.0.1", port or 50_000 + listening.fd)
            listening.backlog = []
            net.listening[listening.address[1]] = listening
            return listening

        def socketpair() -> tuple[Socket, Socket]:
            one, other = Socket(net, process(), real.AF_UNIX), Socket(net, process(), real.AF_UNIX)
            one.peer, other.peer = other, one
            return one, other

        def getaddrinfo(host: str | None, port: Any, *how: Any, **more: Any) -> list[Any]:
            return [(real.AF_INET, real.SOCK_STREAM, 6, "", ("127.0.0.1", port))]

        return {
            "socket": socket,
            "create_server": create_server,
            "socketpair": socketpair,
            "getaddrinfo": getaddrinfo,
            "Poller": partial(Poller, net),
            "poll": partial(PollerMs, net),
        }

    def connect(self, client: Socket, listening: Socket) -> None:
        """Establish a connection, after a short delay."""
        world = self.world
        server = Socket(self, listening.process)
        latency = world.random.choice((20e-6, 100e-6, 1e-3))
        client.latency = server.latency = latency

        def established() -> None:
            if client.closed or listening.closed or not listening.process.alive:
                server.close()
                client.error = errno.ECONNREFUSED
                client.notify()
                return
            client.peer, server.peer = server, client
            assert listening.backlog is not None
            listening.backlog.append(server)
            listening.notify()
            client.notify()

        world.at(world.now + latency, established)
        raise BlockingIOError

    def carry(self, sender: Socket, data: bytes) -> None:
        """Take sent bytes, and let them arrive unless a fault decides otherwise."""
        if sender.family == real.AF_UNIX:
            assert sender.peer is not None
            sender.peer.inbox += data
            sender.peer.notify()
            return
        self.sends += 1
        sender.sent += len(data)
        late = self.on_send(sender, data)
        if late is not None:
            self.transmit(sender, data, late)

    def transmit(self, sender: Socket, item: bytes | str, late: float = 0.0) -> None:
        """Let bytes arrive, or the end of the stream: "end" or "reset", in order and `late` seconds later
        than usual."""
        if sender.lost:
            return
        world = self.world
        if type(item) is bytes:
            sender.flying += len(item)
        sender.queue.append(item)
        due = world.now + sender.latency * (0.5 + world.random.random()) + late
        sender.arrival = due = max(due, sender.arrival, sender.clogged_until)
        world.at(due, self._land, sender)

    def _land(self, sender: Socket) -> None:
        if not sender.queue:
            return
        if sender.clogged_until > self.world.now:
            self.world.at(sender.clogged_until, self._land, sender)
            return
        item = sender.queue.popleft()
        peer = sender.peer
        assert peer is not None
        if isinstance(item, str):
            if item == "reset":
                self.reset(peer)
            elif not peer.closed:
                peer.eof = True
                peer.notify()
            return
        sender.flying -= len(item)
        if peer.closed:
            self.reset(sender)
        elif not (peer.error or peer.eof):  # a connection that has failed takes nothing any more
            peer.inbox += item
            peer.notify()

    def reset(self, end: Socket, error: int = errno.ECONNRESET) -> None:
        """Tell one end that its connection is gone."""
        if not end.closed and not end.error:
            end.lost = True
            end.error = error
            end.notify()

    def cut(self, sender: Socket, clean: bool) -> None:
        """End a connection: the peer receives the bytes sent so far, the sender nothing more."""
        peer = sender.peer
        assert peer is not None
        how = "end" if clean else "reset"
        self.transmit(sender, how)
        sender.lost = True
        peer.queue.clear()
        peer.flying = 0
        peer.lost = False
        self.transmit(peer, how)
        peer.lost = True
