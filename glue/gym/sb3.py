"""Stable-Baselines3: any Gymnasium vector environment for its algorithms, and its policies for RL-Glue.

Stable-Baselines3 takes only vector environments of its own kind. `SB3VecEnv` makes one from a Gymnasium
vector environment that begins episodes in the same step. Policies come from local files, which may execute
code when they are loaded: load only those that you trained yourself. Nothing here reads one from the wire.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Annotated, Any, Final

import numpy as np
import numpy.typing as npt

from glue.errors import ConfigError
from glue.installed import needing
from glue.roles import Agent

# Imported first, because it needs Gymnasium itself: the message names the extra that installs both.
with needing("sb3", "this needs Stable-Baselines3"):
    import stable_baselines3
    from stable_baselines3.common.vec_env import VecEnv

from glue.gym.spaces import Codec, MaskCodec, read_spaces
from glue.gym.vectors import AutoresetMode, infos_of_step, split
from glue.options import Option
from glue.taskspec import parse_task_spec
from glue.types import Action, Observation

_ALGORITHMS: Final = ("PPO", "A2C", "DQN", "SAC", "TD3", "DDPG", "MaskablePPO")
_MASKED: Final = "MaskablePPO"
"""The algorithm that takes masks of the legal actions; it comes with sb3-contrib."""


class SB3VecEnv(VecEnv):  # type: ignore[misc]
    """A Gymnasium vector environment in the form that Stable-Baselines3 expects.

    When an episode is over, `infos[i]` has its last observation as `terminal_observation`, and
    `TimeLimit.truncated`: whether it was only truncated, so that values are bootstrapped. sb3-contrib's
    MaskablePPO finds the masks of the legal actions by the method `action_masks`, if the infos have them.

    Args:
        envs: the vector environment; it is closed with this one.

    Raises:
        ConfigError: its episodes do not begin in the same step (autoreset_mode="SameStep"), or a step
            overwrites the observations of the previous one (copy=False), which Stable-Baselines3 keeps.
    """

    def __init__(self, envs: Any) -> None:
        if envs.metadata.get("autoreset_mode") is not AutoresetMode.SAME_STEP:
            raise ConfigError("Stable-Baselines3 needs autoreset_mode='SameStep' of a vector environment")
        if not getattr(envs.unwrapped, "copy", True):
            raise ConfigError(
                "Stable-Baselines3 keeps observations: it needs copy=True of a vector environment"
            )
        self._envs = envs
        self.render_mode: str | None = envs.render_mode
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)
        self._actions: Any = None
        self._infos: dict[str, Any] = {}  # of the observations last returned

    def reset(self) -> Any:
        """Begin an episode in every game, with the seeds and options that were set."""
        seeds = None if all(seed is None for seed in self._seeds) else [*self._seeds]
        options = next((one for one in self._options if one), None)
        observations, infos = self._envs.reset(seed=seeds, options=options)
        self.reset_infos: list[dict[str, Any]] = split(infos, self.num_envs)
        self._infos = infos
        self._reset_seeds()
        self._reset_options()
        return observations

    def step_async(self, actions: Any) -> None:
        """Take the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, npt.NDArray[np.float32], npt.NDArray[np.bool_], list[dict[str, Any]]]:
        """Carry out the actions; return observations, rewards, which episodes are over, and infos."""
        observations, rewards, terminated, truncated, infos = self._envs.step(self._actions)
        parts = infos_of_step(infos, terminated, truncated)
        self._infos = infos
        return observations, rewards.astype(np.float32), terminated | truncated, parts

    def close(self) -> None:
        """Close the vector environment."""
        self._envs.close()

    def has_attr(self, attr_name: str) -> bool:
        """Return whether the games have an attribute, or masks if it is `action_masks`."""
        if attr_name == "action_masks":
            return "action_mask" in self._infos
        return bool(super().has_attr(attr_name))

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """Return an attribute of the vector environment, once for each game."""
        return [getattr(self._envs.unwrapped, attr_name)] * len(self._chosen(indices))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refuse: the games share their attributes.

        Raises:
            ConfigError: always.
        """
        raise ConfigError(f"{attr_name} cannot be set: the games of a vector environment share it")

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Return the masks if the method is `action_masks`, as sb3-contrib asks for them.

        Raises:
            ConfigError: the method is another one: the games are not separate objects.
        """
        if method_name == "action_masks":
            codec = MaskCodec(self.action_space)
            shown = split(self._infos, self.num_envs)
            masks = [shown[i].get("action_mask") for i in self._chosen(indices)]
            return [
                codec.flat(Observation(mask=None if mask is None else codec.pack(mask))) for mask in masks
            ]
        raise ConfigError(f"{method_name} cannot be called: the games are not separate environments")

    def env_is_wrapped(self, wrapper_class: type[Any], indices: Any = None) -> list[bool]:
        """Return False for each game: games have no wrappers of their own."""
        return [False] * len(self._chosen(indices))

    def get_images(self) -> Sequence[npt.NDArray[np.uint8] | None]:
        """Return a picture of each game, if it was made with a render mode."""
        return self._envs.render() or [None] * self.num_envs

    def _chosen(self, indices: int | Iterable[int] | None) -> list[int]:
        chosen: list[int] = list(self._get_indices(indices))
        return chosen


class SB3Agent(Agent):
    """Plays a policy that Stable-Baselines3 has trained: `glue-agent sb3 --policy model.zip`.

    The task must have the spaces that the policy was trained with, as the layout in its task spec says
    (`glue-env gymnasium:NAME`).
    """

    def __init__(
        self,
        *,
        policy: Annotated[str, Option("file that model.save wrote; only one that you trust")] = "model.zip",
        algorithm: Annotated[str, Option("algorithm that trained it", choices=_ALGORITHMS)] = "PPO",
        deterministic: Annotated[bool, Option("take the most likely action instead of sampling")] = True,
    ) -> None:
        self._path = Path(policy)
        self._algorithm = algorithm
        self._deterministic = deterministic
        self._model = self._load()
        self.agent_masks: bool = algorithm == _MASKED
        self._seed: int | None = None

    def agent_seed(self, seed: int) -> None:
        self._seed = seed

    def agent_init(self, task_spec: str) -> None:
        spec = parse_task_spec(task_spec)
        observations, actions = read_spaces(spec)
        expected = (self._model.observation_space, self._model.action_space)
        if (observations, actions) != expected:
            raise ConfigError(
                f"{self._path} was trained on other observations or actions than this task has: "
                f"{expected[0]!s:.60} with {expected[1]!s:.60}, not {observations!s:.60} with "
                f"{actions!s:.60}. The environment that it was trained on is gymnasium:ID"
            )
        self._observations, self._actions = Codec(observations), Codec(actions)
        self._masks = MaskCodec(actions) if spec.masks and self.agent_masks else None
        if self._seed is not None:
            self._model.set_random_seed(self._seed % 2**32)

    def agent_start(self, observation: Observation) -> Action:
        masks = {} if self._masks is None else {"action_masks": self._masks.flat(observation)}
        action, _ = self._model.predict(
            self._observations.unpack(observation), deterministic=self._deterministic, **masks
        )
        return Action(*self._actions.pack(action))

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return self.agent_start(observation)

    def agent_message(self, message: str) -> str:
        return f"I play {self._path.name}"

    def _load(self) -> Any:
        if not self._path.is_file():
            raise ConfigError(
                f"there is no policy {self._path}: policy should name a file that model.save wrote",
                settings=("policy",),
            )
        algorithm = _algorithm(self._algorithm)
        try:
            return algorithm.load(self._path, device="cpu")
        except Exception as error:
            raise ConfigError(f"{self._path} is not a policy of {self._algorithm}: {error}") from error


def _algorithm(name: str) -> Any:
    """Return the class of an algorithm."""
    if name != _MASKED:
        return getattr(stable_baselines3, name)
    with needing("sb3", "MaskablePPO needs sb3-contrib"):
        import sb3_contrib
    return sb3_contrib.MaskablePPO
