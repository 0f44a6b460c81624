"""The players of `glue-generalise`: an environment that plays numbered levels, and an agent that is reset.

With them a benchmark is a run of ordinary trials. Episodes of learning come first, each on a training level
drawn evenly. Then every scored level has a block: some episodes of relearning, and the scored one. Before
each block the agent is reset to its learned state (agent_save, agent_load), so that neither the order of the
levels nor learning on them matters. An agent that cannot save continues as it is.

With noise, each action is replaced by a random one with a given probability; `Noise` draws the same for
the same trial, level and attempt.

Every episode is played in a fresh game, because Infinite Mario keeps the buttons that an episode leaves
pressed into the next one, and they can change its return.
"""

from __future__ import annotations

import json
import struct
from itertools import product
from pathlib import Path
from typing import Any, Final

import numpy as np

from env_server.mario import InfiniteMario
from env_server.mario.game import Game
from env_server.mario.level_sets import LEVEL_SETS, LevelFolder, LevelSet, read_folder
from env_server.mario.pictures import read_picture
from glue.console import did_you_mean
from glue.errors import ConfigError, SaveError
from glue.options import build
from glue.plugins.loading import find
from glue.roles import Agent, AgentLike, Environment, SaveableAgent, completed, offers
from glue.types import Action, Observation, Step
from glue.wire.messages import Role

LAST_REWARD: Final = "last reward"
"""Message that `SetBack` answers with the last reward of the last episode."""

LAST_ACTIONS: Final = "last actions"
"""Message that `SetBack` answers with the actions of the last episode, a digit of `ACTIONS` for each."""

ACTIONS: Final = {
    digit: Action(ints=buttons)
    for digit, buttons in zip("0123456789ab", product((-1, 0, 1), (0, 1), (0, 1)), strict=True)
}
"""The actions of Infinite Mario by their digits."""

_ALL: Final = tuple(ACTIONS.values())
_DIGITS: Final = {action.body: digit for digit, action in ACTIONS.items()}
_NOISE: Final = 0x6E6F6973  # keeps the noise apart from the other random numbers of a seed
_MIXING: Final = 0x67656E  # keeps the order of the levels apart from the players' random numbers
_EPISODES: Final = struct.Struct("<Q")
_STATE: Final = struct.Struct("<Qd?Q")
"""Number of episodes, last reward, whether the agent has learned, and the size of its learned state."""


def level_set(name: str) -> LevelSet | LevelFolder:
    """Return the set of levels of this name, for NAME:N its first N levels, for a folder those in its files.

    Raises:
        ConfigError: there is no such set, or it has fewer levels; or the levels of a folder have changed.
    """
    if name not in LEVEL_SETS and any(Path(one).is_dir() for one in (name, name.rsplit("#", 1)[0])):
        return read_folder(name)
    name, colon, count = name.partition(":")
    if name not in LEVEL_SETS:
        what = f"{name!r:.80} is neither a folder of levels nor a set of them"
        raise ConfigError(f"{what}{did_you_mean(name, LEVEL_SETS)}")
    found = LEVEL_SETS[name]
    if not colon:
        return found
    most = len(found.numbers)
    if not (count.isascii() and count.isdigit() and 1 <= int(count[:10]) <= most):
        raise ConfigError(f"{name}:N is the first N levels of {name}, N from 1 to {most}, not {count!r:.20}")
    return found._replace(numbers=found.numbers[: int(count)])


def set_name(name: str) -> str:
    """Return the name of a set with the digest of its levels, if they are in a folder.

    Raises:
        ConfigError: as `level_set`, or a file of the folder holds no level.
    """
    found = level_set(name)
    if isinstance(found, LevelSet):
        return name
    if "," in found.name:
        raise ConfigError(f"a folder of levels has no comma in its path, unlike {name}")
    for path, sha256 in found.files:
        read_picture(path, sha256)
    return found.name


def scored_levels(sets: str, difficulty: int = -1) -> list[tuple[LevelSet | LevelFolder, int]]:
    """Return the set and the number of each level that is scored, in order.

    Args:
        sets: names of sets, separated by commas.
        difficulty: the only difficulty that is scored; -1 for all.

    Raises:
        ConfigError: a set is unknown.
    """
    return [
        (levels, number)
        for levels in map(level_set, sets.split(","))
        for number in levels.numbers
        if difficulty in (-1, levels.difficulty(number))
    ]


def digit_of(action: Action) -> str:
    """Return the digit of an action; `?` if Infinite Mario has no such action."""
    return _DIGITS.get(action.body, "?")


def is_won(game: Game) -> bool:
    """Return whether the episode of a game has ended at the goal."""
    return bool(not game.world.playing and game.world.win_timer > 0)


class Noise:
    """Random actions that replace some of an episode's.

    Args:
        probability: that an action is replaced.
        seed: of the trial.
        level: number of the level.
        attempt: number of earlier episodes on the level in its block.
    """

    def __init__(self, probability: float, seed: int, level: int, attempt: int) -> None:
        self._probability = probability
        self._rng = np.random.default_rng([_NOISE, seed, level, attempt])

    def __call__(self, action: Action) -> Action:
        """Return the action to carry out."""
        if self._probability == 0 or self._rng.random() >= self._probability:
            return action
        return _ALL[int(self._rng.integers(len(_ALL)))]


class NumberedLevels(Environment):
    """Infinite Mario, in each episode on the next level of a schedule; a state is saved between episodes."""

    def __init__(
        self,
        *,
        train: str = "train-200",
        sets: str = "train-200,test-1000",
        difficulty: int = -1,
        learn: int = 0,
        relearn: int = 0,
        seed: int = 0,
        noise: float = 0.0,
    ) -> None:
        """Make the schedule.

        Args:
            train: set of the levels for learning.
            sets: sets of the scored levels; see `scored_levels`.
            difficulty: the only difficulty that is scored; -1 for all.
            learn: number of episodes of learning.
            relearn: number of episodes of relearning on each level.
            seed: seed of the order of the training levels and of the noise, at least 0.
            noise: probability that an action is replaced by a random one.

        Raises:
            ConfigError: a set is unknown.
        """
        self._mario = InfiniteMario()
        levels = level_set(train)
        order = np.random.default_rng([_MIXING, seed])
        drawn = (levels.numbers[int(order.integers(len(levels.numbers)))] for _ in range(learn))
        self._schedule: list[tuple[LevelSet | LevelFolder, int, int]]
        self._schedule = [(levels, number, relearn + 1 + i) for i, number in enumerate(drawn)]
        for scored in scored_levels(sets, difficulty):
            self._schedule += [(*scored, attempt) for attempt in range(relearn + 1)]
        self._episodes = 0
        self._seed = seed
        self._probability = noise
        self._noise = Noise(noise, seed, 0, 0)

    def env_init(self) -> str:
        self._episodes = 0
        return self._mario.env_init()

    def env_start(self) -> Observation:
        if self._episodes == len(self._schedule):
            raise ConfigError(f"there are {len(self._schedule)} episodes of this benchmark, and no more")
        levels, number, attempt = self._schedule[self._episodes]
        self._noise = Noise(self._probability, self._seed, number, attempt)
        self._episodes += 1
        self._mario = InfiniteMario(**levels.options(number))
        self._mario.env_init()
        return self._mario.env_start()

    def env_step(self, action: Action) -> Step:
        return self._mario.env_step(self._noise(action))

    def env_cleanup(self) -> None:
        self._mario.env_cleanup()

    def env_message(self, message: str) -> str:
        return self._mario.env_message(message)

    def env_save(self) -> bytes:
        """Return the number of episodes so far."""
        return _EPISODES.pack(self._episodes)

    def env_load(self, data: bytes) -> None:
        """Continue after the episodes of a saved state.

        Raises:
            SaveError: `data` is not such a state.
        """
        try:
            (self._episodes,) = _EPISODES.unpack(data)
        except struct.error as error:
            raise SaveError(f"these are not saved levels: {error}") from None


class SetBack(Agent):
    """An agent that is reset to its learned state before each block of episodes.

    Optional methods are those of the agent itself.
    """

    def __init__(
        self, *, agent: str = "random", options: str = "{}", learn: int = 0, relearn: int = 0
    ) -> None:
        """Construct the agent.

        Args:
            agent: its name, as `glue.plugins.loading.find` takes it.
            options: its options by name, as JSON.
            learn: number of episodes of learning.
            relearn: number of episodes of relearning in each block.

        Raises:
            ConfigError: there is no such agent, or an option is wrong.
        """
        self.__wrapped__: AgentLike = build(find(Role.AGENT, agent), json.loads(options))
        self._agent: Any = completed(self.__wrapped__, Agent)
        self._can_save = offers(self._agent, SaveableAgent)
        self._learn = learn
        self._block = relearn + 1
        self._episodes = 0
        self._learned: bytes | None = None
        self._last_reward = 0.0
        self._actions: list[str] = []

    def __getattr__(self, name: str) -> Any:
        """Return an optional method, if the agent has it."""
        own = getattr(self._agent, name)
        return {"agent_save": self._save, "agent_load": self._load}.get(name, own)

    def agent_init(self, task_spec: str) -> None:
        self._episodes, self._learned, self._last_reward = 0, None, 0.0
        self._agent.agent_init(task_spec)

    def agent_start(self, observation: Observation) -> Action:
        if self._at_block and self._can_save:
            if self._learned is None:
                self._learned = self._agent.agent_save()
            self._agent.agent_load(self._learned)
        self._episodes += 1
        action: Action = self._agent.agent_start(observation)
        self._actions = [digit_of(action)]
        return action

    def agent_step(self, reward: float, observation: Observation) -> Action:
        action: Action = self._agent.agent_step(reward, observation)
        self._actions.append(digit_of(action))
        return action

    def agent_end(self, reward: float) -> None:
        self._last_reward = reward
        self._agent.agent_end(reward)

    def agent_cleanup(self) -> None:
        self._agent.agent_cleanup()

    def agent_message(self, message: str) -> str:
        if message == LAST_REWARD:
            return repr(self._last_reward)
        if message == LAST_ACTIONS:
            return "".join(self._actions)
        answer: str = self._agent.agent_message(message)
        return answer

    @property
    def _at_block(self) -> bool:
        """Whether a block begins with the next episode."""
        return self._episodes >= self._learn and (self._episodes - self._learn) % self._block == 0

    def _save(self) -> bytes:
        learned = self._learned
        # At the beginning of a block the learned state counts, not the current one.
        state = b"" if self._at_block and learned is not None else self._agent.agent_save()
        head = _STATE.pack(self._episodes, self._last_reward, learned is not None, len(learned or b""))
        return head + (learned or b"") + state

    def _load(self, data: bytes) -> None:
        """Continue from a saved state.

        Raises:
            SaveError: `data` is not such a state, or the agent does not accept its own part of it.
        """
        try:
            self._episodes, self._last_reward, has_learned, size = _STATE.unpack_from(data)
        except struct.error as error:
            raise SaveError(f"this is not a saved agent of a benchmark: {error}") from None
        rest = data[_STATE.size :]
        self._learned = rest[:size] if has_learned else None
        if rest[size:]:
            self._agent.agent_load(rest[size:])
