"""The hub: many sessions, in one plain poll loop.

    with Hub(HubConfig()).in_background() as hub:
        print(hub.endpoints)

The loop receives, decodes a small header, lets the sessions act, and sends. Nothing in it waits for a
peer. Other sources of messages, such as the gateway for RL-Glue's original programs, run in the same loop.
"""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from queue import SimpleQueue
from types import FrameType
from typing import Final

from glue.closing import Closing
from glue.errors import ConfigError, GlueError
from glue.hub.config import HubConfig, Keys
from glue.hub.io.channels import Channels
from glue.hub.io.listener import OpenAddress, open_address
from glue.hub.io.log import Log
from glue.hub.io.loop import Loop
from glue.hub.sessions import Sessions
from glue.keys.allowed import read_keys
from glue.system import clock as system_clock
from glue.system import threads

_NONE: Final[Mapping[str, OpenAddress]] = {}


class Hub(Closing):
    """A hub, listening from construction until it is closed.

    It closes when `run` ends; a hub that is never run is closed by `close`, or as a context manager.

    Args:
        config: addresses, times and limits.
        log: called with a line for people about each peer that joins or leaves, in a separate thread, so that
            the hub does not wait for it. Or a `Log`, for more options; the hub closes it.
        opened: addresses of `config.bind`, by URL, that are open already; they stay open when the hub closes.
        clock: returns seconds, to measure the time of agents if `config` limits it; by default the system's.
        processor: returns the seconds that the agent of the only session has used of processors, None if
            unknown; they count beside the clock, see `glue.hub.timing.TimeBank`.

    Attributes:
        config: as given.
        log: passes lines on to the log that was given.
        loop: the loop it runs in; a tick is a heartbeat.
        sessions: receiver of all messages.
        endpoints: the addresses listened on, with free ports resolved.

    Raises:
        ConfigError: an address is in use or cannot be listened on.
    """

    def __init__(
        self,
        config: HubConfig,
        log: Callable[[str], None] | Log = lambda line: None,
        opened: Mapping[str, OpenAddress] = _NONE,
        clock: Callable[[], float] | None = None,
        processor: Callable[[], float | None] | None = None,
    ) -> None:
        self.config = config
        self.log: Log = log if isinstance(log, Log) else Log(log)
        with ExitStack() as closing:
            closing.callback(self.log.close, config.farewell)
            addresses = [
                (bind, opened.get(bind.url) or closing.enter_context(open_address(bind.url)))
                for bind in config.binds
            ]
            self.endpoints: list[str] = [address.endpoint for _, address in addresses]
            self.loop: Loop = Loop(config.heartbeat, self.log.error)
            closing.callback(self.loop.close)
            self.sessions: Sessions = Sessions(
                config, self.log, clock or system_clock.monotonic, self.loop.at, processor
            )
            self._channels = Channels(self.loop, config, addresses, self.sessions, self.log)
            closing.callback(self._channels.close)
            self._closing = closing.pop_all()
        self._closing.callback(self._take_leave)
        self._closers: list[Callable[[], None]] = []
        self._new_keys: Keys | None = None
        self._ended = threads.Event()

    def run(self) -> None:
        """Serve until `stop` is called; then close."""
        self.loop.on_tick(self.sessions.tick)
        self.loop.on_tick(self._renew_keys)
        with self:
            self.loop.run()

    def close(self) -> None:
        """Say goodbye to every peer, and stop listening. A running hub is ended by `stop` instead."""
        self.loop.alone(self._closing.close)  # an experiment in this process may be in a turn

    def wait(self) -> None:
        """Wait until a hub in the background ends.

        Raises:
            GlueError: the hub was not stopped, but failed.
        """
        self._ended.wait()
        if self.loop.stopping is None:
            raise GlueError("internal error in the hub; please report the traceback above")

    def join(self, seconds: float) -> bool:
        """Wait up to `seconds` for a hub in the background to end; return whether it has."""
        return self._ended.wait(seconds)

    def stop(self, reason: str) -> None:
        """Make `run` end; may be called from any thread or signal handler. Peers are sent `reason`."""
        self.loop.stop(reason)

    def renew_keys(self, keys: Keys) -> None:
        """Replace the keys of every address that has any, at the next heartbeat; callable from any thread.

        Peers whose key is gone, or now has another permit, lose their connection and leave their sessions.
        """
        self._new_keys = keys

    def _renew_keys(self, now: float) -> None:
        keys, self._new_keys = self._new_keys, None
        if keys is not None:
            self.log(f"the keys were read again: {keys}")
            self._channels.renew(keys, now)

    @contextmanager
    def in_background(self) -> Iterator[Hub]:
        """Serve in a thread while the body of the `with` runs."""
        thread = threads.Thread(target=self._run_in_background, name="hub", daemon=True)
        thread.start()
        try:
            yield self
        finally:
            self.stop("the experiment is over")
            thread.join()

    def on_close(self, close: Callable[[], None]) -> None:
        """Call `close` when the hub closes, after its peers have been sent a goodbye."""
        self._closers.append(close)

    def _run_in_background(self) -> None:
        try:
            self.run()
        finally:
            self._ended.set()

    def _take_leave(self) -> None:
        self.sessions.close(self.loop.stopping or "the hub failed")
        for close in self._closers:
            close()


@contextmanager
def renewed_on_hangup(hub: Hub, directory: Path) -> Iterator[None]:
    """Make the hub read its keys again whenever this process receives SIGHUP. For the main thread.

    A separate thread reads the keys: a slow disk must not stop the sessions. If they cannot be read, the old
    keys stay in use.
    """
    asked: SimpleQueue[bool] = SimpleQueue()  # its `put` is safe in a signal handler

    def read() -> None:
        while asked.get():
            try:
                hub.renew_keys(read_keys(directory))
            except ConfigError as error:
                reason = " ".join(str(error).split())
                hub.log.error(f"the keys stay as they were: {reason}")

    def renew(number: int, frame: FrameType | None) -> None:
        asked.put(True)

    threads.Thread(target=read, name="keys", daemon=True).start()
    before = signal.signal(signal.SIGHUP, renew)
    try:
        yield
    finally:
        signal.signal(signal.SIGHUP, before)
        asked.put(False)
