"""The replay of recorded actions of Infinite Mario, a whole episode in one call.

`glue-compete verify` finds this class in the entry-point group `glue.replays`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from env_server.mario.environment import InfiniteMario
from glue.types import Action


class MarioReplay:
    """Plays episodes of an environment; see `experiment_runner.competition.records.replay.Replay`.

    Args:
        environment: the environment, after `env_init`.
    """

    def __init__(self, environment: InfiniteMario) -> None:
        self._game = environment.game
        self._buttons_of = environment.buttons_of

    def start(self) -> None:
        """Begin an episode."""
        self._game.start()

    def play(
        self, actions: Sequence[Action], choices: npt.NDArray[np.int64]
    ) -> tuple[npt.NDArray[np.float64], bool]:
        """Carry out actions until the episode ends; return their rewards, and whether it ended.

        Args:
            actions: the different actions.
            choices: indices of the actions to carry out, shape (N,).

        Raises:
            SimulatorError: an action is illegal, or no episode is being played.
        """
        buttons = np.array([self._buttons_of(action) for action in actions], np.int64).reshape(-1, 3)
        return self._game.play(buttons, choices)
