"""An agent that runs of tests copy into their folder, so that they last until the test has done its part."""

from __future__ import annotations

import time
from pathlib import Path

from agents.tabular import SarsaAgent
from glue.types import Action, Observation


class Slow(SarsaAgent):
    """Waits `pause` seconds before each episode as long as the file `while_there` exists."""

    def __init__(self, *, while_there: str = "", pause: float = 0.1) -> None:
        super().__init__()
        self._file = Path(while_there)
        self._pause = pause

    def agent_start(self, observation: Observation) -> Action:
        if self._file.is_file():
            time.sleep(self._pause)
        return super().agent_start(observation)
