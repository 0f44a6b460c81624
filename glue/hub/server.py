"""The hub: many sessions, in one plain poll loop.

    with Hub(HubConfig()).in_background() as hub:
        print(hub.endpoints)

The loop receives, decodes a small header, lets the switchboard act, and sends. Nothing in it waits for a
peer. Other sources of messages, such as the gateway for RL-Glue's original programs, run in the same loop.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from typing import Final

from glue.closing import Closing
from glue.core.config import HubConfig
from glue.core.keys import Keys
from glue.core.sessions import Route, Switchboard
from glue.errors import ConfigError, GlueError, RemoteProtocolError
from glue.hub.listener import OpenAddress, open_address
from glue.hub.log import Log
from glue.hub.loop import Loop
from glue.hub.router import Router
from glue.protocol.messages import Kind
from glue.protocol.wire import TO_HUB, UnknownKind, decode

__all__ = ["Hub"]


_NONE: Final[Mapping[str, OpenAddress]] = {}


class Hub(Closing):
    """A hub, listening from the moment it is made until it is closed.

    It closes when `run` ends; one that is never run is closed by `close`, or as a context manager.

    Args:
        config: addresses, times and limits.
        log: takes a line for people about each peer that joins or leaves, in a thread of its own: nothing in
            the hub waits for it. Or a `Log` to choose more; the hub closes it.
        opened: addresses of `config.bind`, by URL, that are open already; they stay open when the hub closes.
        clock: returns seconds, to measure the time of agents if `config` limits it.

    Attributes:
        config: as given.
        log: passes lines on to the log that was given.
        loop: the loop it runs in; a tick is a heartbeat.
        switchboard: where messages go.
        endpoints: the addresses listened on, free ports resolved.

    Raises:
        ConfigError: an address is in use or cannot be listened on.
    """

    def __init__(
        self,
        config: HubConfig,
        log: Callable[[str], None] | Log = lambda line: None,
        opened: Mapping[str, OpenAddress] = _NONE,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.config = config
        self.log = log if isinstance(log, Log) else Log(log)
        with ExitStack() as closing:
            closing.callback(self.log.close)
            addresses = [
                (bind, opened.get(bind.url) or closing.enter_context(open_address(bind.url)))
                for bind in config.binds
            ]
            self.endpoints = [address.endpoint for _, address in addresses]
            self.loop = Loop(config.heartbeat, self.log.error)
            closing.callback(self.loop.close)
            self.switchboard = Switchboard(config, self.log, clock)
            self._router = Router(
                self.loop,
                config,
                addresses,
                self.receive,
                self.switchboard.receive_step,
                self.switchboard.lose,
                self.switchboard.num_seats,
                self.switchboard.memory,
                self.log,
            )
            closing.callback(self._router.close)
            self._closing = closing.pop_all()
        self._closing.callback(self._take_leave)
        self._closers: list[Callable[[], None]] = []
        self._read_keys: Callable[[], Keys] | None = None
        self._ended = threading.Event()

    def run(self) -> None:
        """Serve until `stop` is called; then close."""
        self.loop.on_tick(self.switchboard.tick)
        self.loop.on_tick(self._renew_keys)
        with self:
            self.loop.run()

    def close(self) -> None:
        """Say goodbye to every peer, and stop listening. A running hub is ended by `stop` instead."""
        self.loop.ask()  # an experiment inside may be in the middle of a turn
        with self.loop.mutex:
            self._closing.close()

    def wait(self) -> None:
        """Wait until a hub in the background ends.

        Raises:
            GlueError: it was not stopped, but failed.
        """
        self._ended.wait()
        if self.loop.stopping is None:
            raise GlueError("the hub failed, by a mistake of its own; please report what is shown above")

    def join(self, seconds: float) -> bool:
        """Wait at most so long for a hub in the background to end; return whether it has."""
        return self._ended.wait(seconds)

    def stop(self, reason: str) -> None:
        """Let `run` end; may be called from any thread or signal handler. Peers are sent `reason`."""
        self.loop.stop(reason)

    def renew_keys(self, read: Callable[[], Keys]) -> None:
        """Replace the keys of every address that has any by those that `read` returns, at the next heartbeat.

        It may be called from any thread or signal handler. Peers whose key is gone, or is for something else
        now, lose their connection and their places. If `read` raises ConfigError, all stays as it was.
        """
        self._read_keys = read

    def _renew_keys(self, now: float) -> None:
        read, self._read_keys = self._read_keys, None
        if read is not None:
            try:
                keys = read()
            except ConfigError as error:
                self.log.error(f"the keys stay as they were: {error}")
            else:
                self.log(f"the keys were read again: {keys}")
                self._router.renew(keys, now)

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
        """Call `close` when the hub closes, after its peers were sent a goodbye."""
        self._closers.append(close)

    def _run_in_background(self) -> None:
        try:
            self.run()
        finally:
            self._ended.set()

    def _take_leave(self) -> None:
        self.switchboard.close(self.loop.stopping or "the hub failed")
        for close in self._closers:
            close()

    def receive(self, route: Route, frames: Sequence[bytes], now: float) -> bool:
        """Act on a message; return whether it was in turn. For the thread that takes the loop's turns.

        Raises:
            RemoteProtocolError: it is malformed, and its sender has no seat.
        """
        try:
            message = decode(frames, TO_HUB, self.config.max_body)
        except RemoteProtocolError as error:
            had_seats = self.switchboard.num_seats(route)
            self.switchboard.malformed(route, error, now)
            if not had_seats and not isinstance(error, UnknownKind):
                raise
            return False
        if message.kind is Kind.HELLO:
            capabilities = message.scalars[-1]
            assert isinstance(capabilities, tuple)
            if "batch" in capabilities:
                self.loop.look_longer()
        return self.switchboard.receive(route, message, now)
