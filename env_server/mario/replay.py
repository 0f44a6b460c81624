"""Recorded actions of Infinite Mario carried out again, a whole episode in one call.

The name of this class stands in the entry-point group `glue.replays`: so `glue-compete verify` finds it.
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
        environment: after `env_init`.
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
            choices: which of them to carry out, shape (N,).

        Raises:
            SimulatorError: an action is illegal, or no episode is being played.
        """
        buttons = np.array([self._buttons_of(action) for action in actions], np.int64).reshape(-1, 3)
        return self._game.play(buttons, choices)
