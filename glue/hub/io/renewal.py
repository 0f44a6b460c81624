"""A hub's keys, read again from their directory on SIGHUP."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from queue import SimpleQueue
from types import FrameType

from glue.errors import ConfigError
from glue.hub.io.server import Hub
from glue.keys.allowed import read_keys
from glue.system import threads


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
