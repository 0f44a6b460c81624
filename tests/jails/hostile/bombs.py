"""Forks and allocates endlessly, in the middle of an episode."""

from __future__ import annotations

import os
from contextlib import suppress

from tests.jails.hostile.honest import Honest, play


class Bombs(Honest):
    def misbehave(self) -> None:
        hoard = []
        while True:
            with suppress(OSError, MemoryError):
                os.fork()
            with suppress(MemoryError):
                hoard.append(bytearray(b"x" * 2**20))


if __name__ == "__main__":
    play(Bombs())
