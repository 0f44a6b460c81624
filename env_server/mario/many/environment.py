"""Many games of Infinite Mario as one RL-Glue environment: `glue-env mario --batch 64`.

`glue.plugins.batched` finds this class in the entry-point group `glue.batches`. One compiled call steps all
games, and another gathers their observations into one message, described in `glue.batches`. Each game equals
an `InfiniteMario` of its own to the byte.
"""

from __future__ import annotations

import os
from typing import Any, Final

import numpy as np
import numpy.typing as npt

from env_server.mario.environment import InfiniteMario
from env_server.mario.many.games import SAME_STEP, Games
from env_server.mario.many.views import BODY, View
from env_server.mario.observation import BODY_SIZE
from glue.batches import Ragged, batch_task_spec, pack_actions, unpack_actions
from glue.compiled.jit import announce_compilation, entry, jit
from glue.errors import ConfigError, SimulatorError
from glue.roles import Environment
from glue.types import PREFIX_SIZE, Action, Observation, Step
from glue.wire.messages import MAX_BODY

_ACTION_INTS: Final = 3
_CHOICES: Final = np.array([3, 2, 2])
_LEFT: Final = np.array([1, 0, 0])
"""Added to a direction, -1 to 1, to get its number, 0 to 2."""
_GAMES_PER_THREAD: Final = 128
"""Number of games that justifies waking another thread."""
_BESIDE: Final = 24
"""Bytes of a game in a message besides its observation: its reward, terminal and counts."""
_MAX_GAMES: Final = MAX_BODY // 400
"""Maximum number of games: no observation is smaller than 400 bytes."""


class InfiniteMarioBatch(Environment):
    """`games` games with the options of one environment; a game that is over begins its next episode at once.

    A batch never ends: the experiment limits its steps. Nothing in the game is random, so there is no seed.

    Args:
        environment: provides the options of each game, and answers the messages.
        games: number of games.

    Raises:
        ConfigError: so many games do not fit into a message, or the environment has extras.
    """

    def __init__(self, environment: InfiniteMario, games: int) -> None:
        if not 1 <= games <= _MAX_GAMES:
            raise ConfigError(f"a batch of Infinite Mario has 1 to {_MAX_GAMES} games, not {games}")
        if environment.env_extras:
            raise ConfigError("a batch carries no extras: leave out the option extras")
        self.__wrapped__ = environment
        self._count = games
        self._games: Games | None = None
        self._message = np.empty(games * (BODY_SIZE + _BESIDE) + 8, np.uint8)
        counts = np.tile(np.array([_ACTION_INTS, 0, 0], np.int32), (games, 1))
        still = Ragged(counts, np.zeros(counts.size, np.int32), np.empty(0), np.empty(0, np.uint8))
        self._head = pack_actions(still).body[: -4 * counts.size]

    def env_batch(self) -> int:
        """Return the number of games."""
        return self._count

    def env_init(self) -> str:
        """Make fresh games; return the task spec of the batch."""
        task_spec = self.__wrapped__.env_init()
        self._close()
        tasks = [self.__wrapped__.parameters] * self._count
        threads = min(os.cpu_count() or 1, self._count // _GAMES_PER_THREAD)
        self._games = Games(tasks, View(BODY, BODY_SIZE, 0), SAME_STEP, threads=max(1, threads))
        with announce_compilation("messages of many games"):
            self._shown(self._games)
        return batch_task_spec(self._count, task_spec)

    def env_start(self) -> Observation:
        """Rebuild the level of each game, and return the first observations.

        Raises:
            SimulatorError: env_init has not been called yet.
        """
        games = self._playing()
        games.reset()
        return self._shown(games)

    def env_step(self, action: Action) -> Step:
        """Hold the buttons of each game's action for five ticks.

        Returns:
            The sum of the rewards, the batch, and False.

        Raises:
            RemoteProtocolError: `action` does not hold the actions of so many games.
            SimulatorError: an action is out of bounds or misshapen, or there is no episode to step in. No
                game is stepped then.
        """
        games, buttons = self._playing(), self._buttons(action)
        refused = games.step(buttons + _LEFT, _CHOICES)
        if refused >= self._count:
            refused -= self._count
            raise SimulatorError(
                f"direction is -1 to 1, jump and run 0 or 1; received {buttons[refused].tolist()} for game "
                f"{refused}"
            )
        if refused >= 0:
            raise SimulatorError(f"game {refused} has no episode being played: start it first")
        return Step(float(games.lanes["reward"].copy().sum()), self._shown(games), False)

    def env_cleanup(self) -> None:
        """Release the games, and any level that a message asked for."""
        self._close()
        self.__wrapped__.env_cleanup()

    def env_message(self, message: str) -> str:
        """Answer as each of the games would; a requested level applies to all games."""
        before = self.__wrapped__.parameters
        answer = self.__wrapped__.env_message(message)
        task = self.__wrapped__.parameters
        if self._games is not None and task is not before:
            self._games.set_tasks([task] * self._count)
        return answer

    def _playing(self) -> Games:
        if self._games is None:
            raise SimulatorError("there are no games yet: call env_init first")
        return self._games

    def _close(self) -> None:
        if self._games is not None:
            self._games.close()
            self._games = None

    def _buttons(self, action: Action) -> npt.NDArray[np.int32]:
        # Everything in a valid message except the buttons is known before it arrives.
        if action.body.startswith(self._head):
            return action.ints[-_ACTION_INTS * self._count :].reshape(-1, _ACTION_INTS)
        for game, one in enumerate(unpack_actions(action, self._count).values(Action)):
            try:
                InfiniteMario.buttons_of(one)
            except SimulatorError as error:
                raise SimulatorError(f"game {game}: {error}") from None
        raise AssertionError("actions of the right shape begin otherwise")

    def _shown(self, games: Games) -> Observation:
        lanes = games.lanes
        size = _gather(games.cells, lanes["reward"].copy(), lanes["terminated"].copy(), self._message)
        return Observation.from_body(self._message[:size].tobytes())


@entry
def _gather(
    bodies: npt.NDArray[np.uint8],
    rewards: npt.NDArray[np.float64],
    ended: npt.NDArray[np.bool_],
    message: npt.NDArray[np.uint8],
) -> int:
    """Write the rewards, ends and observations of all games as the body of a batch; return its length."""
    games = len(bodies)
    own_words, own_reals = bodies.view(np.int32), bodies.view(np.float64)
    ints, doubles, chars = 1 + 4 * games, games, 0
    for i in range(games):
        ints += own_words[i, 0]
        doubles += own_words[i, 1]
        chars += own_words[i, 2]
    words, reals = message.view(np.int32), message.view(np.float64)
    words[0], words[1], words[2], words[3] = ints, doubles, chars, 0
    # Index of the next number of each kind, in units of its size.
    real = PREFIX_SIZE // 8
    word = PREFIX_SIZE // 4 + 2 * doubles
    char = 4 * (word + ints)
    words[word] = games
    for i in range(games):
        reals[real + i] = rewards[i]
        words[word + 1 + i] = ended[i]
        for kind in range(3):
            words[word + 1 + (1 + kind) * games + i] = own_words[i, kind]
    real += games
    word += 1 + 4 * games
    for i in range(games):
        num_ints, num_doubles, num_chars = own_words[i, 0], own_words[i, 1], own_words[i, 2]
        at = PREFIX_SIZE // 8
        _copy(own_reals[i, at : at + num_doubles], reals[real:])
        at = 2 * (at + num_doubles)
        _copy(own_words[i, at : at + num_ints], words[word:])
        at = 4 * (at + num_ints)
        _copy(bodies[i, at : at + num_chars], message[char:])
        real += num_doubles
        word += num_ints
        char += num_chars
    return char


@jit
def _copy(source: npt.NDArray[Any], target: npt.NDArray[Any]) -> None:
    """Copy a row to the beginning of another; compiled, that is eight times as fast as a slice assignment."""
    for i in range(len(source)):
        target[i] = source[i]
