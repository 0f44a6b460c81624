"""Any Gymnasium environment as an RL-Glue environment: `glue-env gymnasium:CartPole-v1`.

Its spaces become the task spec (see `glue.gym.spaces`), and its truncations those of the steps. Of its infos
only those are sent that are asked for: the mask of the legal actions, and named values as extras. An action
of floats is clipped to its bounds; any other action that is not in the space is refused without stepping the
environment. An observation that is not in its space is an error, except that floats may exceed their bounds.

Seeds are made for Gymnasium's generator, of 64 bits. Many environments draw from NumPy's old one: it is
seeded, too, and a seed that their reset refuses is given again in fewer bits. An environment whose reset does
not even read its seed has no `env_seed`, and is treated as any player without one.

PettingZoo's classic games for one player are served likewise: `glue-env pettingzoo:connect_four_v3`. The
other players are agents of this process, such as `random` or one of your own, and play their turns within a
step. An observation is PettingZoo's `observation`, with its `action_mask` as mask. A reward is what the
player has earned since its last action. As in PettingZoo, who makes an illegal move loses the game.
"""

from __future__ import annotations

import dis
import inspect
from collections.abc import Callable, Mapping, Sequence
from importlib.util import find_spec
from typing import Annotated, Any, Final

import gymnasium
import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import load_env_creator

from glue.engine.calls import role_calls
from glue.errors import ConfigError, SimulatorError, TaskSpecError, described
from glue.global_seeds import seed_globals
from glue.gym.spaces import Codec, MaskCodec, SpaceLike, task_spec
from glue.options import Option, keywords, option, with_options
from glue.plugins.loading import import_user_module, make_agent
from glue.roles import Agent, Environment, MaskAgent, offers
from glue.types import Action, Observation, Step
from glue.wire.messages import Kind, Role

_TEXT: Final = "ansi"
"""The render mode of environments that are drawn as text."""

_SEEDS: Final = 2**63
_OLD_SEEDS: Final = 2**31  # That fit C's int. NumPy's old generator takes twice as many.

_OURS: Final = [
    option(
        "max_episode_steps",
        None,
        Annotated[
            int | None,
            Option("steps after which an episode is cut off, in place of the registered limit", low=1),
        ],
    ),
    option("action_mask", False, Annotated[bool, Option("send the action_mask of infos to the agent")]),
    option("infos", "", Annotated[str, Option("values of infos to send as extras, by name: lives,score")]),
]
"""Options of every environment, besides its own keywords."""


class GymnasiumEnvironment(Environment):
    """A Gymnasium environment, served to RL-Glue.

    Args:
        make: makes the environment. It is called once by the constructor, for the spaces, and again after
            a cleanup.
        masks: whether observations have the mask of their info's `action_mask`, if there is one; see
            `glue.gym.spaces`.
        infos: names of the values in an info that become extras.

    The capability `save` is offered if the environment itself has methods `env_save` and `env_load`, as in
    `glue.roles`: Gymnasium has no save format that is safe to load.

    Raises:
        ConfigError: a space cannot be described by a task spec, or an action of it not by a mask.
    """

    def __init__(self, make: Callable[[], Any], *, masks: bool = False, infos: Sequence[str] = ()) -> None:
        self._make = make
        self._env: Any = make()
        self._observations = Codec(self._env.observation_space)
        self._actions = Codec(self._env.action_space)
        self._task_spec = task_spec(self._observations, self._actions, masks)
        self._masks = _mask_codec(self._env.action_space) if masks else None
        self._infos = infos
        self.env_masks: bool = masks
        self.env_extras: bool = bool(infos)
        self._seed: int | None = None
        self._seeds = _SEEDS
        self._playing = False
        own = self._env.unwrapped
        if callable(getattr(own, "env_save", None)) and callable(getattr(own, "env_load", None)):
            self.env_save: Callable[[], bytes] = lambda: self._opened().unwrapped.env_save()
            self.env_load: Callable[[bytes], None] = lambda saved: self._opened().unwrapped.env_load(saved)

    def env_seed(self, seed: int) -> None:
        """Seed the next episode, and thereby those after it."""
        self._seed = seed
        seed_globals(seed)

    def env_init(self) -> str:
        """Return the task spec that describes the spaces."""
        if self._env is None:
            self._env = self._make()
        self._playing = False
        return self._task_spec

    def env_start(self) -> Observation:
        """Reset the environment; return its observation."""
        seed, self._seed = self._seed, None
        try:
            observation, info = self._opened().reset(seed=seed if seed is None else seed % self._seeds)
        except (ValueError, OverflowError, TypeError):
            if seed is None or seed % self._seeds < _OLD_SEEDS:
                raise
            self._seed, self._seeds = seed, _OLD_SEEDS
            self._env.close()
            self._env = self._make()  # Gymnasium's wrappers are of no use after a reset that failed.
            return self.env_start()
        self._playing = True
        return self._shown(observation, info, False)

    def env_step(self, action: Action) -> Step:
        """Carry out an action.

        Raises:
            SimulatorError: the action is not in the space, or no episode is being played.
        """
        env = self._opened()
        if not self._playing:
            raise SimulatorError("no episode is being played: env_start begins one")
        observation, reward, terminated, truncated, info = env.step(self._actions.unpack(action))
        self._playing = not (terminated or truncated)
        shown = self._shown(observation, info, bool(terminated))
        return Step(float(reward), shown, not self._playing, bool(truncated and not terminated))

    def env_cleanup(self) -> None:
        """Close the environment."""
        if self._env is not None:
            self._env.close()
        self._env = None

    def env_message(self, message: str) -> str:
        """Answer `spaces` with the spaces of observations and actions."""
        if message == "spaces":
            return f"observations {self._observations.space}, actions {self._actions.space}"
        return f"refused: {message!r:.80} is not a message of a Gymnasium environment; this is: spaces"

    def draw(self) -> list[str] | None:
        """Return the lines of the environment's own drawing as text; None if it has none."""
        if self._env is None or self._env.render_mode != _TEXT:
            return None
        return str(self._env.render()).splitlines()

    def _shown(self, observation: Any, info: Mapping[str, Any], terminated: bool) -> Observation:
        """Return an observation as ints, doubles and chars, with what is asked for of its info.

        Raises:
            SimulatorError: it is not in the space, or its mask does not fit the actions.
            LocalProtocolError: a value of the info is none that an extra may have.
        """
        mask = None
        if self._masks is not None and not terminated and (given := info.get("action_mask")) is not None:
            mask = self._masks.pack(given)  # after the end no action is legal
        extras = {name: info[name] for name in self._infos if name in info}
        try:
            return Observation(*self._observations.pack(observation), mask=mask, extras=extras)
        except SimulatorError as error:
            raise SimulatorError(f"the environment's observation is not in its space: {error}") from None

    def _opened(self) -> Any:
        if self._env is None:
            raise SimulatorError("the environment was cleaned up: call env_init first")
        return self._env


def environment_class(name: str) -> type[GymnasiumEnvironment]:
    """Return a class whose options are the keywords of the Gymnasium environment `name`.

    Args:
        name: as for `gymnasium.make`: `CartPole-v1`, or `module:ID` to import a module first.

    Raises:
        ConfigError: there is no such environment.
    """
    try:
        module, _, identifier = name.rpartition(":")
        if module:
            import_user_module(module)  # it registers the environment
        spec = gymnasium.spec(identifier)
        creator = (
            load_env_creator(spec.entry_point) if isinstance(spec.entry_point, str) else spec.entry_point
        )
    except (gymnasium.error.Error, ConfigError, ImportError, AttributeError) as error:
        raise ConfigError(f"Gymnasium has no environment {name!r} here: {error}") from None
    if creator is None:
        raise ConfigError(f"Gymnasium's {name} has no entry point")

    drawn = (
        {"render_mode": _TEXT} if _TEXT in getattr(creator, "metadata", {}).get("render_modes", ()) else {}
    )

    def __init__(
        self: GymnasiumEnvironment, *, action_mask: bool = False, infos: str = "", **options: Any
    ) -> None:
        def make() -> Any:
            try:
                return gymnasium.make(name, **drawn, **options)
            except Exception as error:
                why = (
                    error if isinstance(error, gymnasium.error.Error) else f"{type(error).__name__}: {error}"
                )
                raise ConfigError(f"Gymnasium cannot make {name}: {why}") from error

        names = [name.strip() for name in infos.split(",") if name.strip()]
        GymnasiumEnvironment.__init__(self, make, masks=action_mask, infos=names)

    known = keywords(creator, "keyword of the Gymnasium environment", _OURS, "render_mode", spec.kwargs)
    members: dict[str, Any] = {
        "__init__": with_options(__init__, known),
        # Repeatability without a seed is up to its author.
        "__module__": getattr(creator, "__module__", __name__),
        "__doc__": f"Gymnasium's {spec.id}, served to RL-Glue agents (docs/gymnasium.md).",
    }
    if not _reads_seed(creator):
        members["env_seed"] = None
    return type(spec.id.replace("/", "-"), (GymnasiumEnvironment,), members)


def _mask_codec(space: Any) -> MaskCodec:
    try:
        return MaskCodec(space)
    except TaskSpecError as error:
        raise ConfigError(f"actions of {space} have no masks: {error}") from None


def _reads_seed(creator: Any) -> bool:
    """Return whether an environment's reset reads its parameter `seed`; True if that is not known."""
    reset = getattr(creator, "reset", None)
    code = None if reset is None else getattr(inspect.unwrap(reset), "__code__", None)
    if code is None or "seed" not in code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]:
        return True
    loaded = [one.argval for one in dis.get_instructions(code) if "LOAD_FAST" in one.opname]
    # One instruction of Python 3.13 loads two variables.
    return "seed" in code.co_cellvars or any("seed" in ((x,) if isinstance(x, str) else x) for x in loaded)


_OF_GAMES: Final = [
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
    creator = getattr(module, "raw_env", make)
    options = keywords(creator, "keyword of the PettingZoo game", _OF_GAMES, "render_mode")

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
        "__init__": with_options(__init__, options),
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
