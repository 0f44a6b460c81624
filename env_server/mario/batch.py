"""Many games stepped in one call: for planning, and for learning from many games at once.

    with Batch([InfiniteMario(level_seed=seed).parameters for seed in range(64)]) as batch:
        batch.start()
        rewards, ended = batch.step(np.tile([1, 0, 1], (64, 1)))
        batch.start(ended)

The games share nothing: each plays as it would alone, however many threads there are.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Final

import numpy as np
import numpy.typing as npt

from env_server.mario.game import start_first, start_world, step_world
from env_server.mario.observation import BODY_SIZE
from env_server.mario.parameters import Parameters
from env_server.mario.sim.state import WORLD, World, Worlds
from env_server.mario.threads import Threads
from glue.closing import Closing
from glue.compiled.jit import announce_compilation, entry
from glue.compiled.turns import CALLER, Gate, begin_turn, end_turn
from glue.errors import SimulatorError
from glue.types import Observation

__all__ = ["Batch"]

_GAMES_PER_THREAD: Final = 128  # to wake a thread for fewer costs more than it saves
_NO_ACTIONS: Final = np.zeros((0, 3), np.int64)


class Batch(Closing):
    """N games. Close it at the end, or use it in a `with` statement, because it has threads.

    Args:
        tasks: one task per game; N is how many there are.
        threads: how many cores to use; by default as many as are useful.
        restarts: whether a game that is over begins its next episode in the same step.

    Attributes:
        bodies: each game's last observation as the body of an abstract type, shape (N, BODY_SIZE), uint8.
    """

    def __init__(
        self, tasks: Sequence[Parameters], *, threads: int | None = None, restarts: bool = False
    ) -> None:
        self._worlds: Worlds = np.zeros(len(tasks), WORLD)
        self.set_tasks(tasks)
        self.bodies = np.zeros((len(tasks), BODY_SIZE), np.uint8)
        self._sizes = np.zeros(len(tasks), np.int64)
        self._actions = np.zeros((len(tasks), 3), np.int64)
        self._rewards = np.zeros(len(tasks))
        self._ended = np.zeros(len(tasks), np.bool_)
        worth_it = min(os.cpu_count() or 1, len(tasks) // _GAMES_PER_THREAD)
        workers = max(1, worth_it if threads is None else threads)
        self._threads = Threads(workers, len(tasks))
        self._restarts = restarts
        self._load()

    def __len__(self) -> int:
        return len(self._worlds)

    def close(self) -> None:
        """End the threads."""
        self._threads.close()

    def set_tasks(self, tasks: Sequence[Parameters]) -> None:
        """Let each game play another task from its next episode on."""
        for world, task in zip(self._worlds, tasks, strict=True):
            task.write_to(world)

    def start(self, which: npt.NDArray[np.bool_] | None = None) -> None:
        """Begin an episode in every game, or in those where `which`, shape (N,), is true."""
        chosen = range(len(self)) if which is None else np.flatnonzero(which)
        for i in chosen:
            self._sizes[i] = start_first(self._worlds[i : i + 1], self.bodies[i])

    def step(self, actions: npt.NDArray[np.integer]) -> tuple[npt.NDArray[np.float64], npt.NDArray[np.bool_]]:
        """Carry out one action in every game.

        Args:
            actions: shape (N, 3): direction -1 to 1, jump and run 0 or 1.

        Returns:
            The rewards, shape (N,), and whether each episode ended, shape (N,). After an end the observation
            is still the one before it, or that of the next episode if the batch `restarts`.

        Raises:
            SimulatorError: an action is out of bounds, or a game has no episode being played.
        """
        self._actions[:] = self._checked(actions)
        outcome = (self._rewards, self._ended, self._sizes, self.bodies, self._restarts)
        self._threads.run(_step_range, self._worlds, self._actions, *outcome)
        return self._rewards.copy(), self._ended.copy()

    def observation(self, i: int) -> Observation:
        """Return the last observation of game `i`."""
        return Observation.from_body(self.bodies[i, : self._sizes[i]].tobytes())

    def _load(self) -> None:
        """Load the compiled rules, or compile them and say so."""
        with announce_compilation("Infinite Mario"):
            start_first(np.zeros(1, WORLD), np.zeros(BODY_SIZE, np.uint8))
            _first_wrong(self._worlds[:0], _NO_ACTIONS)
            nothing = (_NO_ACTIONS, np.empty(0), np.empty(0, np.bool_), self._sizes, self.bodies, False)
            _step_range(np.zeros(1, np.int64), CALLER, self._worlds, *nothing, 0, 0)

    def _checked(self, actions: npt.NDArray[np.integer]) -> npt.NDArray[np.int64]:
        if actions.shape != (len(self), 3):
            raise SimulatorError(
                f"actions for {len(self)} games have shape ({len(self)}, 3), not {actions.shape}"
            )
        checked = actions.astype(np.int64, order="C")
        i = _first_wrong(self._worlds, checked)
        if i < 0:
            return checked
        if self._worlds[i]["playing"]:
            raise SimulatorError(
                f"direction is -1 to 1, jump and run 0 or 1; received {actions[i].tolist()} for game {i}"
            )
        raise SimulatorError(f"game {i} has no episode being played: start it first")


@entry
def _first_wrong(worlds: Worlds, actions: npt.NDArray[np.int64]) -> int:
    """Return the first game that cannot carry out its action, or -1."""
    for i in range(len(worlds)):
        world: World = worlds[i]
        in_bounds = -1 <= actions[i, 0] <= 1 and 0 <= actions[i, 1] <= 1 and 0 <= actions[i, 2] <= 1
        if not (in_bounds and world.playing):
            return i
    return -1


@entry
def _step_range(
    gate: Gate,
    worker: int,
    worlds: Worlds,
    actions: npt.NDArray[np.int64],
    rewards: npt.NDArray[np.float64],
    ended: npt.NDArray[np.bool_],
    sizes: npt.NDArray[np.int64],
    bodies: npt.NDArray[np.uint8],
    restarts: bool,
    first: int,
    last: int,
) -> None:
    """Carry out an action in the games from `first` up to `last`, whenever it is their turn."""
    while begin_turn(gate, worker):
        for i in range(first, last):
            world: World = worlds[i]
            reward, size = step_world(world, actions[i, 0], actions[i, 1], actions[i, 2], bodies[i])
            rewards[i] = reward
            ended[i] = size == 0
            if size == 0 and restarts:
                size = start_world(world, bodies[i])
            if size > 0:
                sizes[i] = size
        if end_turn(gate, worker):
            return
