"""Crashes in the middle of an episode, without notifying the hub."""

from __future__ import annotations

import os

from glue.types import Action
from tests.jails.hostile.honest import Honest, play


class Crashes(Honest):
    def act(self) -> Action:
        if self.steps == 20:
            os._exit(3)
        return super().act()


if __name__ == "__main__":
    play(Crashes())
