"""The hub: many sessions over one ROUTER, in one plain poll loop.

    with Hub(HubConfig()).in_background() as hub:
        print(hub.endpoints)

The loop receives, decodes a small header, lets the switchboard act, and sends. Nothing in it waits for a
peer. Other sources of messages, such as the gateway for RL-Glue's original programs, join the same
loop with `watch`.
"""

from __future__ import annotations

import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Final, Protocol, cast

import zmq

from glue.config import HubConfig
from glue.errors import RemoteProtocolError
from glue.messages import Message
from glue.sessions import Route, Switchboard
from glue.wire import FROM_HUB, MAX_HEADER, TO_HUB, decode, encode
from glue.zmq_transport import Context, RouterTransport

__all__ = ["GatewayRoute", "Hub"]

_OWN_ROUTE: Final = (
    "leave the routing id (ZMQ_IDENTITY) of your socket unset: by a new one the hub knows a new connection"
)


class GatewayRoute(Protocol):
    """A route that is not a ZeroMQ connection: a client of a gateway."""

    def deliver(self, message: Message) -> bool:
        """Pass `message` on; return False if the client is gone."""
        ...


class Hub:
    """A hub, listening from the moment it is made.

    Args:
        config: addresses, times and limits.
        context: the ZeroMQ context to use; peers of the same process on `inproc://` need the same one.
        log: takes a line for people about each coming and going.

    Attributes:
        config: as given.
        switchboard: where messages go.

    Raises:
        ConfigError: an address is taken or cannot be bound.
    """

    def __init__(
        self,
        config: HubConfig,
        context: Context | None = None,
        log: Callable[[str], None] = lambda line: None,
    ) -> None:
        self.config = config
        self._transport = RouterTransport(
            context or zmq.Context.instance(),
            config.bind,
            config.patience,
            # What is only a little too long is read, and answered with an error that says so.
            config.max_body + MAX_HEADER,
        )
        self.switchboard = Switchboard(config, self._send, log)
        self._poller = zmq.Poller()
        self._poller.register(self._transport.socket, zmq.POLLIN)
        self._wake, self._waker = socket.socketpair()
        self._waker.setblocking(False)
        self._stopping: str | None = None
        self._ended = threading.Event()
        self._readers: dict[int, Callable[[float], None]] = {}
        self._tickers: list[Callable[[float], None]] = []
        self._closers: list[Callable[[], None]] = []
        self.watch(self._wake.fileno(), zmq.POLLIN, lambda now: None)

    @property
    def endpoints(self) -> list[str]:
        """The addresses listened on, free ports resolved."""
        return self._transport.endpoints

    def run(self) -> None:
        """Serve until `stop` is called; then tell every peer, and close."""
        try:
            self._loop()
        finally:
            self.switchboard.close(self._stopping or "the hub failed")
            for close in self._closers:
                close()
            self._transport.close()
            self._wake.close()
            self._waker.close()
            self._ended.set()

    def wait(self) -> None:
        """Wait until a hub in the background ends."""
        self._ended.wait()

    def stop(self, reason: str) -> None:
        """Let `run` end; may be called from any thread or signal handler. Peers are told `reason`."""
        self._stopping = self._stopping or reason
        try:
            self._waker.send(b"\0")
        except OSError:
            # Full or closed: the loop is awake or over.
            return

    @contextmanager
    def in_background(self) -> Iterator[Hub]:
        """Serve in a thread while the body of the `with` runs."""
        thread = threading.Thread(target=self.run, name="hub", daemon=True)
        thread.start()
        try:
            yield self
        finally:
            self.stop("the experiment is over")
            thread.join()

    def watch(self, fd: int, events: int, ready: Callable[[float], None]) -> None:
        """Call `ready` with the time whenever `fd` is; `events` are zmq.POLLIN and POLLOUT. Loop only."""
        self._readers[fd] = ready
        self._poller.register(fd, events)

    def unwatch(self, fd: int) -> None:
        """Undo `watch`. Loop only."""
        del self._readers[fd]
        self._poller.unregister(fd)

    def on_tick(self, tick: Callable[[float], None]) -> None:
        """Call `tick` with the time at every heartbeat, before the switchboard's own. Before `run`."""
        self._tickers.append(tick)

    def on_close(self, close: Callable[[], None]) -> None:
        """Call `close` when the hub ends, after its peers were told."""
        self._closers.append(close)

    def _loop(self) -> None:
        heartbeat = self.config.heartbeat
        router = self._transport.socket
        poll = self._poller.poll
        tick_at = time.monotonic() + heartbeat
        while self._stopping is None:
            ready = poll(max(0, int((tick_at - time.monotonic()) * 1000) + 1))
            now = time.monotonic()
            for source, _ in ready:
                if source is router:
                    self._receive(now)
                elif source in self._readers:
                    self._readers[source](now)
            if now >= tick_at:
                for tick in self._tickers:
                    tick(now)
                self.switchboard.tick(now)
                tick_at = now + heartbeat

    def _receive(self, now: float) -> None:
        route, frames = self._transport.receive()
        try:
            if route[0]:
                # Those that the ROUTER gives begin with a zero.
                raise RemoteProtocolError(_OWN_ROUTE)
            message = decode(frames, TO_HUB, self.config.max_body)
        except RemoteProtocolError as error:
            self.switchboard.malformed(route, error, now)
        else:
            self.switchboard.receive(route, message, now)

    def _send(self, route: Route, message: Message) -> bool:
        if type(route) is bytes:
            return self._transport.send(route, encode(message, FROM_HUB))
        return cast(GatewayRoute, route).deliver(message)
