"""Sleeps forever, in the middle of an episode."""

from __future__ import annotations

import time

from tests.jails.hostile.honest import Honest, play


class Sleeps(Honest):
    def misbehave(self) -> None:
        while True:
            time.sleep(1000)


if __name__ == "__main__":
    play(Sleeps())
