"""The shares of exact predictions of a belief, by the number of steps that they look ahead."""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from agents.planner.search import model
from glue.compiled.records import Array

_AHEAD: Final = (1, 3, 5, 10)  # steps
_LONGEST: Final = _AHEAD[-1]


class Horizons:
    """The beliefs of the last steps, each stepped with the actions since, without any correction."""

    def __init__(self) -> None:
        self._worlds = [model.make()[0] for _ in range(_LONGEST)]
        self._compared = dict.fromkeys(_AHEAD, 0)
        self._exact = dict.fromkeys(_AHEAD, 0)
        self._steps = 0

    def start(self) -> None:
        """Begin an episode: nothing has been predicted."""
        self._steps = 0

    def step(self, worlds: Array, levels: Array, action: int) -> None:
        """Predict from the belief `worlds`, shape (1,), before an action, and from the beliefs before it."""
        self._worlds[self._steps % _LONGEST].view(np.uint8)[:] = worlds.view(np.uint8)
        self._steps += 1
        for world in self._worlds[: self._steps]:
            model.step(world, levels, action)

    def compare(self, levels: Array, body: npt.NDArray[np.uint8]) -> None:
        """Compare an observation with its predictions."""
        for ahead in _AHEAD:
            if ahead <= self._steps:
                world = self._worlds[(self._steps - ahead) % _LONGEST]
                self._compared[ahead] += 1
                self._exact[ahead] += model.predicts(world, levels, body)

    def shares(self) -> dict[str, float]:
        """Return the share of exact predictions by the steps that they look ahead."""
        return {str(n): self._exact[n] / max(self._compared[n], 1) for n in _AHEAD}
