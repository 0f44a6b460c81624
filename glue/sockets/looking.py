"""Look for what is about to arrive before falling asleep: to be woken takes longer than many answers.

A processor with nothing to do sleeps, too, and in a virtual machine takes 50 to 100 microseconds to wake. A
step of many games would wait for that four times: on its way to the hub, to the agent, and back.
"""

from __future__ import annotations

import os
import socket
import time
from typing import Final

__all__ = ["LONG_LOOK_SECONDS", "SEVERAL_CORES", "give_way", "receive_soon"]

LONG_LOOK_SECONDS: Final = 300e-6
"""How long to look for the message of many games: 64 games of Infinite Mario are stepped within it."""

SEVERAL_CORES: Final = not hasattr(os, "sched_getaffinity") or len(os.sched_getaffinity(0)) > 1
"""On a single core nobody could answer while somebody looks."""


def receive_soon(connected: socket.socket, size: int, seconds: float) -> bytes | None:
    """Return up to `size` bytes that are received within `seconds`, or None.

    Raises:
        OSError: the connection is broken.
    """
    until = time.monotonic() + seconds
    while True:
        try:
            return connected.recv(size, socket.MSG_DONTWAIT)
        except BlockingIOError:
            if time.monotonic() >= until:
                return None
        give_way()


def _keep_on() -> None:
    """Do nothing: there is no way to let others go first."""


give_way: Final = getattr(os, "sched_yield", _keep_on)
"""Let whoever waits for this core go first: it may be the one that is to answer."""
