"""Forks and allocates endlessly, in the middle of an episode."""

from __future__ import annotations

import os
from contextlib import suppress

from glue.types import Action
from tests.jails.hostile.honest import Honest, play


class Bombs(Honest):
    def act(self) -> Action:
        if self.steps == 20:
            hoard = []
            while True:
                with suppress(OSError, MemoryError):
                    os.fork()
                with suppress(MemoryError):
                    hoard.append(bytearray(b"x" * 2**20))
        return super().act()


if __name__ == "__main__":
    play(Bombs())
