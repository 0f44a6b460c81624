"""PettingZoo's classic games for one player: `glue-env pettingzoo:connect_four_v3`.

The other players are agents of this process, such as `random` or one of your own, and play their turns within
a step. An observation is PettingZoo's `observation`, with its `action_mask` as mask. A reward is what the
player has earned since its last action. As in PettingZoo, who makes an illegal move loses the game.
"""

from __future__ import annotations

from collections.abc import Callable
from importlib.util import find_spec
from typing import Annotated, Any, Final

import gymnasium
import numpy as np
from gymnasium import spaces

from glue.engine.calls import role_calls
from glue.errors import ConfigError, SimulatorError, described
from glue.gym.served import GymnasiumEnvironment
from glue.gym.spaces import Codec, MaskCodec, SpaceLike, task_spec
from glue.options import Option, keywords, option, with_options
from glue.plugins.loading import import_user_module, make_agent
from glue.roles import Agent, MaskAgent, offers
from glue.types import Observation
from glue.wire.messages import Kind, Role

_OURS: Final = [
    option("opponent", "random", Annotated[str, Option("agent of each other player, as for glue-agent")]),
    option("player", 0, Annotated[int, Option("place of the agent in the order of play, from 0 on", low=0)]),
]
_GAMES: Final = 1000
"""Games in a row that may be over before the player's first turn."""

_Shown = tuple[Any, dict[str, Any]]


def game_class(name: str) -> type[GymnasiumEnvironment]:
    """Return the class of a game for one player, whose options are the game's keywords.

    Args:
        name: of a module of `pettingzoo.classic`, such as `chess_v6`, or of any other, with a dot, that has a
            function `env` which makes a game with turns (PettingZoo's AEC).

    Raises:
        ConfigError: there is no such game here.
    """
    if find_spec("pettingzoo") is None:
        raise ConfigError("this needs PettingZoo: pip install 'glue-rl[pettingzoo]'")
    module = import_user_module(name if "." in name else f"pettingzoo.classic.{name}")
    make = getattr(module, "env", None)
    if not callable(make):
        raise ConfigError(f"{module.__name__} has no function env, which makes a game of PettingZoo's")
    taken = {"render_mode", *(ours.name for ours in _OURS)}
    options = keywords(getattr(module, "raw_env", make), "keyword of the PettingZoo game")

    def __init__(
        self: GymnasiumEnvironment, *, opponent: str = "random", player: int = 0, **given: Any
    ) -> None:
        def side() -> Side:
            try:
                game = make(**given)
            except Exception as error:
                raise ConfigError(f"PettingZoo cannot make {name}: {described(error)}") from error
            return Side(game, player, lambda: make_agent(opponent))

        GymnasiumEnvironment.__init__(self, side, masks=True)

    members: dict[str, Any] = {
        "__init__": with_options(__init__, [*(one for one in options if one.name not in taken), *_OURS]),
        "__module__": __name__,
        "__doc__": f"PettingZoo's {name} for one player, served to RL-Glue agents (docs/masks.md).",
    }
    return type(name.rpartition(".")[2], (GymnasiumEnvironment,), members)


class Side(gymnasium.Env[Any, Any]):  # type: ignore[misc]
    """One player's side of a game of PettingZoo's, as a `gymnasium.Env`; its infos have the `action_mask`.

    Args:
        game: the game; it is closed with this environment.
        player: place of the player in the order of play, from 0 on.
        opponent: makes an agent for each of the other players.

    Raises:
        ConfigError: there is no such place, or a task spec cannot describe the spaces.
    """

    def __init__(self, game: Any, player: int, opponent: Callable[[], Agent]) -> None:
        names = game.possible_agents
        if not 0 <= player < len(names):
            raise ConfigError(f"player must be from 0 to {len(names) - 1}, the last place, not {player}")
        self._game = game
        self._me = names[player]
        self.observation_space: SpaceLike = _observation_space(game, self._me)
        self.action_space: SpaceLike = game.action_space(self._me)
        self._opponents = {name: _Opponent(game, name, opponent()) for name in names if name != self._me}

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> _Shown:
        """Begin a game, and play it up to the player's first turn; a seed also seeds the opponents.

        A game that is over before the player's first turn does not count: another begins.

        Raises:
            SimulatorError: the player never has a turn.
        """
        super().reset(seed=seed)
        for _ in range(_GAMES):
            for opponent in self._opponents.values():
                opponent.begin(None if seed is None else self._number())
            seed = None
            self._game.reset(seed=self._number())
            observation, _, terminated, truncated, info = self._my_turn()
            if not (terminated or truncated):
                return observation, info
        raise SimulatorError(f"{_GAMES} games were over before the first turn of {self._me}")

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Make a move, then those of the others, up to the player's next turn or the end."""
        self._game.step(action)
        return self._my_turn()

    def close(self) -> None:
        """Close the game, and let the opponents clean up."""
        for opponent in self._opponents.values():
            opponent.close()
        self._game.close()

    def _number(self) -> int:
        return int(self.np_random.integers(2**31))

    def _my_turn(self) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Let the others play up to the player's turn or, if the game is over, until they know it, too."""
        game = self._game
        while game.agent_selection != self._me:
            self._opponents[game.agent_selection].play()
        shown = _last(game)
        if shown[2] or shown[3]:
            game.step(None)
            while game.agents:
                self._opponents[game.agent_selection].play()
        return shown


class _Opponent:
    """The agent that plays for one of the other players."""

    def __init__(self, game: Any, name: str, agent: Agent) -> None:
        self._game = game
        self._calls = role_calls(Role.AGENT, agent)
        self._sees_masks = offers(agent, MaskAgent)
        self._observations = Codec(_observation_space(game, name))
        self._actions = Codec(game.action_space(name))
        self._masks = MaskCodec(game.action_space(name))
        self._initialised = self._playing = False

    def begin(self, seed: int | None) -> None:
        """Begin a game; with a seed, nothing is left of those before."""
        self._playing = False
        if seed is not None and Kind.AGENT_SEED in self._calls:
            self._calls[Kind.AGENT_SEED]((seed,), None)
        if seed is not None or not self._initialised:
            self._calls[Kind.AGENT_INIT]((), task_spec(self._observations, self._actions, masks=True))
            self._initialised = True

    def close(self) -> None:
        """Let the agent clean up."""
        if self._initialised:
            self._calls[Kind.AGENT_CLEANUP]((), None)

    def play(self) -> None:
        """Make a move, or learn that the game is over."""
        shown, reward, terminated, truncated, info = _last(self._game)
        if terminated or truncated:
            if self._playing and terminated:
                self._calls[Kind.AGENT_END]((reward,), None)
            self._game.step(None)
            return
        mask = self._masks.pack(info["action_mask"]) if self._sees_masks and "action_mask" in info else None
        observation = Observation(*self._observations.pack(shown), mask=mask)
        kind = Kind.AGENT_STEP if self._playing else Kind.AGENT_START
        _, action = self._calls[kind]((reward,), observation)
        self._playing = True
        self._game.step(self._actions.unpack(action))


def _last(game: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
    """Return the observation of the player whose turn it is, as Gymnasium's `step` does."""
    observation, reward, terminated, truncated, info = game.last()
    if isinstance(observation, dict) and "observation" in observation:
        info = {**info, **observation}
        observation = info.pop("observation")
    if getattr(observation, "dtype", None) == np.bool_:
        observation = observation.astype(np.uint8)
    return observation, float(reward), terminated, truncated, info


def _observation_space(game: Any, name: str) -> SpaceLike:
    space = game.observation_space(name)
    if isinstance(space, spaces.Dict) and "observation" in space.spaces:
        space = space["observation"]
    if isinstance(space, spaces.Box) and space.dtype == np.bool_:
        return spaces.Box(0, 1, space.shape, np.uint8)
    return space
