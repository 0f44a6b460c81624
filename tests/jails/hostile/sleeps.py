"""Sleeps forever, in the middle of an episode."""

from __future__ import annotations

import time

from glue.types import Action
from tests.jails.hostile.honest import Honest, play


class Sleeps(Honest):
    def act(self) -> Action:
        if self.steps == 20:
            while True:
                time.sleep(1000)
        return super().act()


if __name__ == "__main__":
    play(Sleeps())
