"""Crashes in the middle of an episode, without notifying the hub."""

from __future__ import annotations

import os

from tests.jails.hostile.honest import Honest, play


class Crashes(Honest):
    def misbehave(self) -> None:
        print("the last words of crashes")
        os._exit(3)


if __name__ == "__main__":
    play(Crashes())
