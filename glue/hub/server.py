"""The hub: many sessions, in one plain poll loop.

    with Hub(HubConfig()).in_background() as hub:
        print(hub.endpoints)

The loop receives, decodes a small header, lets the switchboard act, and sends. Nothing in it waits for a
peer. Other sources of messages, such as the gateway for RL-Glue's original programs, wait in the same loop.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Protocol, cast

from glue.config import HubConfig
from glue.core.sessions import Route, Switchboard
from glue.errors import ConfigError, GlueError, RemoteProtocolError
from glue.hub.loop import Loop
from glue.hub.router import Router
from glue.protocol.messages import Message
from glue.protocol.wire import TO_HUB, decode

__all__ = ["Hub", "Reachable"]


class Reachable(Protocol):
    """What the switchboard's routes are here: somebody at the other end of a connection."""

    def deliver(self, message: Message) -> bool:
        """Pass `message` on; return False if whoever it is for is gone."""
        ...


def _deliver(route: Route, message: Message) -> bool:
    return cast(Reachable, route).deliver(message)


class Hub:
    """A hub, listening from the moment it is made.

    Args:
        config: addresses, times and limits.
        log: takes a line for people about each coming and going.

    Attributes:
        config: as given.
        loop: what it waits in; a tick is a heartbeat.
        switchboard: where messages go.

    Raises:
        ConfigError: an address is taken or cannot be listened on.
    """

    def __init__(self, config: HubConfig, log: Callable[[str], None] = lambda line: None) -> None:
        self.config = config
        self.loop = Loop(config.heartbeat)
        self.switchboard = Switchboard(config, _deliver, log)
        try:
            self._router = Router(self.loop, config, self._receive, self.switchboard.routes, log)
        except ConfigError:
            self.loop.close()
            raise
        self._ended = threading.Event()
        self._closers: list[Callable[[], None]] = []

    @property
    def endpoints(self) -> list[str]:
        """The addresses listened on, free ports resolved."""
        return self._router.endpoints

    def run(self) -> None:
        """Serve until `stop` is called; then tell every peer, and close."""
        self.loop.on_tick(self.switchboard.tick)
        try:
            self.loop.run()
        finally:
            self.switchboard.close(self.loop.stopping or "the hub failed")
            for close in self._closers:
                close()
            self._router.close()
            self.loop.close()

    def wait(self) -> None:
        """Wait until a hub in the background ends.

        Raises:
            GlueError: it was not stopped, but failed.
        """
        self._ended.wait()
        if self.loop.stopping is None:
            raise GlueError("the hub failed, by a mistake of its own; please report what is shown above")

    def stop(self, reason: str) -> None:
        """Let `run` end; may be called from any thread or signal handler. Peers are told `reason`."""
        self.loop.stop(reason)

    @contextmanager
    def in_background(self) -> Iterator[Hub]:
        """Serve in a thread while the body of the `with` runs."""
        thread = threading.Thread(target=self._run_in_background, name="hub", daemon=True)
        thread.start()
        try:
            yield self
        finally:
            self.stop("the experiment is over")
            thread.join()

    def on_close(self, close: Callable[[], None]) -> None:
        """Call `close` when the hub ends, after its peers were told."""
        self._closers.append(close)

    def _run_in_background(self) -> None:
        try:
            self.run()
        finally:
            self._ended.set()

    def _receive(self, route: Route, frames: list[bytes], now: float) -> None:
        try:
            message = decode(frames, TO_HUB, self.config.max_body)
        except RemoteProtocolError as error:
            self.switchboard.malformed(route, error, now)
        else:
            self.switchboard.receive(route, message, now)
