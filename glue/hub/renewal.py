"""A hub's keys, read from their directory, and read again on SIGHUP."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from types import FrameType

from glue.hub.server import Hub
from glue.keys.allowed import read_keys

__all__ = ["renewed_on_hangup"]


@contextmanager
def renewed_on_hangup(hub: Hub, directory: Path) -> Iterator[None]:
    """Have the hub read its keys again whenever this process receives SIGHUP. For the main thread."""

    def renew(number: int, frame: FrameType | None) -> None:
        hub.renew_keys(partial(read_keys, directory))

    before = signal.signal(signal.SIGHUP, renew)
    try:
        yield
    finally:
        signal.signal(signal.SIGHUP, before)
