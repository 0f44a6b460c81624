"""One game for Python callers: memory, the compiled rules, observations; and a level as data.

Events become a reward: an ordinary reward is the difference of two running totals, not a sum of
increments: the last bits of the two differ. A terminal reward is paid instead of the earnings of the
unfinished step.
Source: RL-Competition 2009, Infinite Mario's check-in and its ends of an episode.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from itertools import zip_longest
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from env_server.mario.observation import BODY_SIZE, encode
from env_server.mario.parameters import Parameters
from env_server.mario.sim import state
from env_server.mario.sim.state import World
from env_server.mario.sim.step import act, begin
from env_server.mario.sim.tiles import CHANGED
from glue.compiled.jit import announce_compilation, entry, jit
from glue.errors import SimulatorError
from glue.types import Observation


class Spawn(NamedTuple):
    """A spawn point of an enemy; `kind` is 0 red koopa, 1 green koopa, 2 goomba, 3 spiky, 4 piranha plant."""

    column: int
    row: int
    kind: int
    winged: bool


class Level(NamedTuple):
    """A level, as it is when an episode begins.

    Attributes:
        columns: width in tiles.
        goal: the column to pass, and the row of the ground there.
        rows: the tiles, highest row first; two hexadecimal digits per tile.
        spawns: by column, then row.
    """

    columns: int
    goal: tuple[int, int]
    rows: tuple[str, ...]
    spawns: tuple[Spawn, ...]


def level_difference(expected: Level, got: Level) -> str:
    """Return the first difference between two levels, in words; "" if there is none."""
    for what, old, new in _pairs(expected, got):
        if old != new:
            return f"the level's {what}: expected {old!r}, got {new!r}"
    return ""


def _pairs(expected: Level, got: Level) -> Iterator[tuple[str, Any, Any]]:
    """Yield every part of two levels by name; if only one level has a part, the other value is None."""
    yield "width", expected.columns, got.columns
    yield "goal", expected.goal, got.goal
    for row, tiles in enumerate(zip_longest(expected.rows, got.rows, fillvalue="")):
        for column, (old, new) in enumerate(zip_longest(*map(_codes, tiles))):
            yield f"tile in column {column}, row {row}", old, new
    for number, (spawn, ours) in enumerate(zip_longest(expected.spawns, got.spawns)):
        yield f"spawn point {number}", spawn, ours


def _codes(row: str) -> list[str]:
    return [row[i : i + 2] for i in range(0, len(row), 2)]


@jit
def ordinary_reward(world: World) -> float:
    """Return the reward earned since the last check-in, and note it as paid."""
    total = (
        world.reward_step * (world.steps - 1) + world.reward_coin * world.coins
    ) + world.reward_kill * world.kills
    reward = total - world.paid
    world.paid = total
    return reward


@jit
def terminal_reward(world: World) -> float:
    """Return the reward of an episode's last step. Winning takes precedence over dying."""
    return world.reward_goal if world.win_timer > 0 else world.reward_death


Body = npt.NDArray[np.uint8]
"""Buffer for an observation as the body of an abstract type, shape (BODY_SIZE,)."""


_NO_EPISODE: Final = "a step needs an episode: call start first, and again after each end"


class Game:
    """A game of a task. Two games share nothing, and a game's future depends only on its memory.

    Args:
        parameters: the task.
    """

    def __init__(self, parameters: Parameters) -> None:
        self._memory: state.Worlds = np.zeros(1, state.WORLD)
        self._level: state.Levels = np.zeros(1, state.LEVEL)
        self._shared = False  # whether a clone may play on this level too
        self._body = np.zeros(BODY_SIZE, np.uint8)
        self._bytes = self._body.data
        self._observation = Observation()
        self.set_task(parameters)
        _prepare()

    @property
    def world(self) -> state.World:
        """The memory of the game, for inspection; see `env_server.mario.sim.state`."""
        world: state.World = self._memory[0]
        return world

    @property
    def level_map(self) -> state.LevelMap:
        """The memory of the level as it was generated."""
        level: state.LevelMap = self._level[0]
        return level

    @property
    def level(self) -> Level:
        """The level as it is now; its tiles show used blocks and collected coins."""
        level = self.level_map
        tiles, spawns = level.tiles[: level.columns], level.spawns[: level.columns]
        changed = self.world.changed[: level.columns, np.newaxis] >> np.arange(state.ROWS) & 1
        tiles = np.where(changed == 1, CHANGED[tiles], tiles)
        return Level(
            int(level.columns),
            (int(level.exit_x), int(level.exit_y)),
            tuple(tiles[:, row].tobytes().hex() for row in range(state.ROWS)),
            tuple(_spawn(x, y, int(spawns[x, y])) for x, y in np.argwhere(spawns).tolist()),
        )

    def set_task(self, parameters: Parameters) -> None:
        """Play another task from the next episode on."""
        parameters.write_to(self.world)
        self._picture = parameters.level

    def start(self) -> Observation:
        """Begin an episode; return its first observation."""
        if self._picture is not None:
            if self.level_map.seed != self.world.level_seed:
                self._level, self._shared = self._picture.levels(), False
        elif self._shared:
            self._level, self._shared = np.zeros(1, state.LEVEL), False
        _, size = _carry_out(self._memory, self._level, True, 0, 0, 0, self._body)
        self._observation = Observation._wrap(bytes(self._bytes[:size]))
        return self._observation

    def step(self, direction: int, jump: int, run: int) -> tuple[float, Observation, bool]:
        """Carry out an action for five ticks; return reward, observation and whether the episode ended.

        The observation of an episode's last step is a copy of the previous one.

        Args:
            direction: -1 left, 1 right, 0 neither.
            jump, run: 1 to hold the button, else 0.

        Raises:
            SimulatorError: no episode is being played.
        """
        reward, size = _carry_out(self._memory, self._level, False, direction, jump, run, self._body)
        if size > 0:
            self._observation = Observation._wrap(bytes(self._bytes[:size]))
            return reward, self._observation, False
        if size < 0:
            raise SimulatorError(_NO_EPISODE)
        return reward, self._observation, True

    def play(
        self, buttons: npt.NDArray[np.int64], choices: npt.NDArray[np.int64]
    ) -> tuple[npt.NDArray[np.float64], bool]:
        """Carry out many actions in a row, until the episode ends, without their observations.

        Args:
            buttons: different actions, shape (K, 3): direction -1 to 1, jump and run 0 or 1.
            choices: rows of `buttons` to carry out, shape (N,), each from 0 to K - 1.

        Returns:
            The reward of each action carried out, shape (N,) or shorter, and whether the episode ended.

        Raises:
            SimulatorError: no episode is being played.
        """
        if not self.world.playing:
            raise SimulatorError(_NO_EPISODE)
        rewards = np.empty(len(choices))
        count = _play_first(self._memory, self._level, buttons, choices, rewards)
        return rewards[:count], not self.world.playing

    def clone(self) -> Game:
        """Return another game at the same point."""
        game = Game.__new__(Game)
        game._memory = self._memory.view(np.uint8).copy().view(state.WORLD)
        game._level, game._picture = self._level, self._picture
        game._shared = self._shared = True
        game._body = np.zeros(BODY_SIZE, np.uint8)
        game._bytes = game._body.data
        game._observation = self._observation
        return game

    def restore(self, other: Game) -> None:
        """Take over the state of `other`."""
        self._memory.view(np.uint8)[:] = other._memory.view(np.uint8)
        self._level, self._picture = other._level, other._picture
        self._shared = other._shared = True
        self._observation = other._observation


def _spawn(column: int, row: int, code: int) -> Spawn:
    return Spawn(column, row, (code & state.SPAWN_KIND) - state.RED_KOOPA, code & state.SPAWN_WINGED != 0)


@entry
def _carry_out(
    worlds: state.Worlds, levels: state.Levels, begins: bool, direction: int, jump: int, run: int, body: Body
) -> tuple[float, int]:
    """Begin an episode in the first of `worlds`, or carry out an action in it.

    One function does both, because the rules are compiled into every function that calls them.

    Returns:
        The reward, and the length of the observation now in `body`: 0 if the episode ended, -1 if there is no
        episode.
    """
    world: state.World = worlds[0]
    level: state.LevelMap = levels[0]
    if begins:
        begin(world, level)
    elif not world.playing:
        return 0.0, -1
    elif not act(world, level, direction, jump, run):
        return terminal_reward(world), 0
    # The reward of the first check-in is noted as paid, although the agent does not receive it.
    return ordinary_reward(world), encode(world, level, body)


@entry
def _play_first(
    worlds: state.Worlds,
    levels: state.Levels,
    buttons: npt.NDArray[np.int64],
    choices: npt.NDArray[np.int64],
    rewards: npt.NDArray[np.float64],
) -> int:
    """Carry out actions in the first of `worlds`, like `Game.play`; return how many."""
    world: state.World = worlds[0]
    level: state.LevelMap = levels[0]
    for i in range(len(choices)):
        action = buttons[choices[i]]
        if not act(world, level, action[0], action[1], action[2]):
            rewards[i] = terminal_reward(world)
            return i + 1
        rewards[i] = ordinary_reward(world)
    return len(choices)


@cache
def _prepare() -> None:
    """Load the compiled rules or, on first use, compile them and announce it."""
    with announce_compilation("Infinite Mario"):
        _carry_out(
            np.zeros(1, state.WORLD), np.zeros(1, state.LEVEL), True, 0, 0, 0, np.zeros(BODY_SIZE, np.uint8)
        )
