"""Many games stepped in one call, on several cores: for planning, and for learning from many games at once.

    with Batch([InfiniteMario(level_seed=seed).parameters for seed in range(64)]) as batch:
        batch.start()
        rewards, ended = batch.step(np.tile([1, 0, 1], (64, 1)))
        batch.start(ended)

The games share nothing: each plays as it would alone, however many threads there are.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import Final, Self

import numpy as np
import numpy.typing as npt

from env_server.game import start_first, step_world
from env_server.observation import BODY_SIZE
from env_server.parameters import Parameters
from env_server.sim._jit import entry, say_when_compiling
from env_server.sim.state import WORLD, World, Worlds
from glue.errors import SimulatorError
from glue.types import Observation

__all__ = ["Batch"]

_LOWEST: Final = np.array([-1, 0, 0])
_HIGHEST: Final = np.array([1, 1, 1])


class Batch:
    """N games. To be closed at the end, or used in a `with` statement, because of its threads.

    Args:
        tasks: one task per game; N is how many there are.
        threads: how many cores to use; all by default.
    """

    def __init__(self, tasks: Sequence[Parameters], *, threads: int | None = None) -> None:
        self._worlds: Worlds = np.zeros(len(tasks), WORLD)
        for i, task in enumerate(tasks):
            task.write_to(self._worlds[i])
        self._bodies = np.zeros((len(tasks), BODY_SIZE), np.uint8)
        self._sizes = np.zeros(len(tasks), np.int64)
        workers = max(1, min(threads or os.cpu_count() or 1, len(tasks)))
        bounds = [len(tasks) * worker // workers for worker in range(workers + 1)]
        self._ranges = list(pairwise(bounds))
        self._pool = ThreadPoolExecutor(max(1, workers - 1), "mario")

    def __len__(self) -> int:
        return len(self._worlds)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """End the threads."""
        self._pool.shutdown()

    def start(self, which: npt.NDArray[np.bool_] | None = None) -> None:
        """Begin an episode in every game, or in those where `which`, shape (N,), is true."""
        chosen = range(len(self)) if which is None else np.flatnonzero(which)
        for i in chosen:
            self._sizes[i] = start_first(self._worlds[i : i + 1], self._bodies[i])

    def step(self, actions: npt.NDArray[np.integer]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
        """Carry out one action in every game.

        Args:
            actions: shape (N, 3): direction -1 to 1, jump and run 0 or 1.

        Returns:
            The rewards, shape (N,), and whether each episode ended, shape (N,). After an end, the
            observation is still the one before it.

        Raises:
            SimulatorError: an action is out of bounds, or a game has no episode being played.
        """
        actions = self._checked(actions)
        rewards = np.empty(len(self))
        ended = np.empty(len(self), np.bool_)
        shared = (self._worlds, actions, rewards, ended, self._sizes, self._bodies)
        others = [self._pool.submit(_step_range, *shared, *part) for part in self._ranges[1:]]
        _step_range(*shared, *self._ranges[0])
        for other in others:
            other.result()
        return rewards, ended

    def observation(self, i: int) -> Observation:
        """Return the last observation of game `i`."""
        return Observation.from_body(self._bodies[i, : self._sizes[i]].tobytes())

    def _checked(self, actions: npt.NDArray[np.integer]) -> npt.NDArray[np.int64]:
        if actions.shape != (len(self), 3):
            raise SimulatorError(
                f"actions for {len(self)} games have shape ({len(self)}, 3), not {actions.shape}"
            )
        wrong = ((actions < _LOWEST) | (actions > _HIGHEST)).any(axis=1)
        if wrong.any():
            i = int(wrong.argmax())
            raise SimulatorError(
                f"direction is -1 to 1, jump and run 0 or 1; {actions[i].tolist()} came for game {i}"
            )
        idle = self._worlds["playing"] == 0
        if idle.any():
            raise SimulatorError(f"game {int(idle.argmax())} has no episode being played: start it first")
        return actions.astype(np.int64)


@entry
def _step_range(
    worlds: Worlds,
    actions: npt.NDArray[np.int64],
    rewards: npt.NDArray[np.float64],
    ended: npt.NDArray[np.bool_],
    sizes: npt.NDArray[np.int64],
    bodies: npt.NDArray[np.uint8],
    first: int,
    last: int,
) -> None:
    """Carry out an action in the games from `first` up to `last`."""
    for i in range(first, last):
        world: World = worlds[i]
        reward, size = step_world(world, actions[i, 0], actions[i, 1], actions[i, 2], bodies[i])
        rewards[i] = reward
        ended[i] = size == 0
        if size > 0:
            sizes[i] = size
