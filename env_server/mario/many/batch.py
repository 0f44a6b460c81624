"""Many games stepped in one call: for planning, and for learning from many games at once.

    with MarioBatch([InfiniteMario(level_seed=seed).parameters for seed in range(64)]) as batch:
        batch.start()
        rewards, ended = batch.step(np.tile([1, 0, 1], (64, 1)))
        batch.start(ended)

The games share nothing: each plays as a single game would, whatever the number of threads.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from env_server.mario.many.games import DISABLED, SAME_STEP, Games
from env_server.mario.many.views import BODY, View
from env_server.mario.observation import BODY_SIZE
from env_server.mario.parameters import Parameters
from glue.closing import Closing
from glue.errors import SimulatorError
from glue.types import Observation

_GAMES_PER_THREAD: Final = 128
"""Number of games that justifies waking another thread."""
_CHOICES: Final = np.array([3, 2, 2])
_LEFT: Final = np.array([1, 0, 0])
"""Added to a direction, -1 to 1, to get its number, 0 to 2."""


class MarioBatch(Closing):
    """N games as RL-Glue's agents see them. Close the batch at the end, or use a `with` statement.

    Args:
        tasks: one for each game.
        threads: number of threads; by default as many as are useful.
        restarts: whether a game that is over begins its next episode in the same step.

    Attributes:
        bodies: each game's last observation as the body of an abstract type, shape (N, BODY_SIZE), uint8.
    """

    def __init__(
        self, tasks: Sequence[Parameters], *, threads: int | None = None, restarts: bool = False
    ) -> None:
        useful = min(os.cpu_count() or 1, len(tasks) // _GAMES_PER_THREAD)
        threads = max(1, useful if threads is None else threads)
        mode = SAME_STEP if restarts else DISABLED
        self._games = Games(tasks, View(BODY, BODY_SIZE, 0), mode, threads=threads)
        self.bodies: npt.NDArray[np.uint8] = self._games.cells

    def __len__(self) -> int:
        return len(self._games)

    def close(self) -> None:
        """End the threads."""
        self._games.close()

    def set_tasks(self, tasks: Sequence[Parameters]) -> None:
        """Let each game play another task from its next episode on."""
        self._games.set_tasks(tasks)

    def start(self, which: npt.NDArray[np.bool_] | None = None) -> None:
        """Begin an episode in every game, or in those where `which`, shape (N,), is true."""
        self._games.reset(which)

    def step(self, actions: npt.NDArray[np.integer]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
        """Carry out one action in every game.

        Args:
            actions: shape (N, 3): direction -1 to 1, jump and run 0 or 1.

        Returns:
            The rewards, shape (N,), and whether each episode ended, shape (N,). When it ended, the
            observation is still the previous one, or that of the next episode if the batch `restarts`.

        Raises:
            SimulatorError: an action is out of bounds, or a game has no episode being played. No game is
                stepped then.
        """
        count = len(self)
        if actions.shape != (count, 3):
            raise SimulatorError(f"actions for {count} games have shape ({count}, 3), not {actions.shape}")
        refused = self._games.step(actions + _LEFT, _CHOICES)
        if refused >= count:
            raise SimulatorError(
                f"direction is -1 to 1, jump and run 0 or 1; received {actions[refused - count].tolist()} "
                f"for game {refused - count}"
            )
        if refused >= 0:
            raise SimulatorError(f"game {refused} has no episode being played: start it first")
        lanes = self._games.lanes
        return lanes["reward"].copy(), lanes["terminated"].copy()

    def observation(self, i: int) -> Observation:
        """Return the last observation of game `i`."""
        return Observation.from_body(self.bodies[i, : self._games.lanes["size"][i]].tobytes())
