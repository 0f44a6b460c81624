"""Floods the hub with garbage from many connections: noise, half messages, and well-formed nonsense."""

from __future__ import annotations

import os
import socket
import threading
from contextlib import suppress

import numpy as np

_GREETING = bytes([0xFF, *[0] * 8, 0x7F, 3, 0]) + b"NULL".ljust(20, b"\0") + bytes(32)
_READY = b"\x04\x1a\x05READY\x0bSocket-Type\0\0\0\x06DEALER"
_HUGE = b"\x02" + (2**62).to_bytes(8, "big")


def flood(number: int, generator: np.random.Generator) -> None:
    """Connect, send one kind of garbage until the hub hangs up, and start over."""
    openings = (b"", _GREETING, _GREETING + _READY, _GREETING + _READY + _HUGE)
    while True:
        with suppress(OSError), socket.socket(socket.AF_UNIX) as connected:
            connected.settimeout(1.0)
            connected.connect(os.environ["GLUE_HUB"].removeprefix("ipc://"))
            connected.sendall(openings[number % len(openings)])
            while True:
                connected.sendall(generator.bytes(4096))


if __name__ == "__main__":
    threads = [
        threading.Thread(target=flood, args=(number, generator), daemon=True)
        for number, generator in enumerate(np.random.default_rng(0).spawn(32))
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
