"""Floods the hub with garbage from many connections: noise, and messages that are too long or never end."""

from __future__ import annotations

import os
import socket
import threading
import time
from contextlib import suppress

import numpy as np

_GREETING = bytes([0xFF, *[0] * 8, 0x7F, 3, 0]) + b"NULL".ljust(20, b"\0") + bytes(32)
_READY = b"\x04\x1a\x05READY\x0bSocket-Type\0\0\0\x06DEALER"
_TOO_LONG = b"\x02" + (2**62).to_bytes(8, "big")
_LONG = b"\x02" + (16 * 2**20).to_bytes(8, "big")
"""The beginning of a frame of the largest size that a hub accepts."""


def flood(number: int, generator: np.random.Generator) -> None:
    """Connect, send one kind of garbage, and start over when the hub hangs up."""
    hello = _GREETING + _READY
    openings = (b"", _GREETING, hello, hello + _TOO_LONG, hello + _LONG)
    while True:
        with suppress(OSError), socket.socket(socket.AF_UNIX) as connected:
            connected.settimeout(1.0)
            connected.connect(os.environ["GLUE_HUB"].removeprefix("ipc://"))
            connected.sendall(openings[number % len(openings)])
            for _ in range(16 * 2**20 // 4096 - 1):
                connected.sendall(generator.bytes(4096))
            while True:
                time.sleep(1000)


if __name__ == "__main__":
    threads = [
        threading.Thread(target=flood, args=(number, generator), daemon=True)
        for number, generator in enumerate(np.random.default_rng(0).spawn(32))
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
