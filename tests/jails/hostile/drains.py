"""Takes a little longer for each answer than a step allows, and so drains its bank slowly."""

from __future__ import annotations

import time

from glue.types import Action
from tests.jails.hostile.honest import Honest, play


class Drains(Honest):
    def act(self) -> Action:
        time.sleep(0.75)
        return super().act()


if __name__ == "__main__":
    play(Drains())
