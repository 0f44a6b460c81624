"""Many games of Infinite Mario as a `gymnasium.vector.VectorEnv`, stepped in one compiled call."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Final

import numpy as np
import numpy.typing as npt
from gymnasium.spaces import Space
from gymnasium.utils.seeding import np_random
from gymnasium.vector import VectorEnv
from gymnasium.vector.utils import batch_space

from env_server.gym.rendering import FPS, RENDER_MODES, Renderer
from env_server.gym.spaces import (
    CHOICES,
    action_space,
    make_games,
    observation_space,
    read_actions,
    unpack,
    what_is_wrong_with,
)
from env_server.mario.level_sets import resolve_levels
from env_server.mario.many.games import DISABLED, INFOS, NEXT_STEP, SAME_STEP, Games
from glue.errors import ConfigError, SimulatorError
from glue.gym.vectors import AutoresetMode, read_mode

_MODES = {
    AutoresetMode.NEXT_STEP: NEXT_STEP,
    AutoresetMode.SAME_STEP: SAME_STEP,
    AutoresetMode.DISABLED: DISABLED,
}
_FLAGS = 2  # number of leading INFOS that are bools
_KEYS: Final = (*INFOS, *(f"_{name}" for name in INFOS))


_METADATA: Final = {"render_modes": [*RENDER_MODES[:2]], "render_fps": FPS}


class InfiniteMarioVectorEnv(VectorEnv[Any, Any, Any]):  # type: ignore[misc]
    """`num_envs` games, each as `InfiniteMarioEnv` would play it with the seed `seed + i`.

    Args:
        num_envs: number of games.
        max_episode_steps: steps after which an episode is truncated; None for no such limit.
        autoreset_mode: Gymnasium's NEXT_STEP, SAME_STEP or DISABLED, or its value.
        num_threads: threads that step the games, used while that is faster. Results do not depend on them.
        copy: False returns views of memory that the next step overwrites.
        observation, action, levels, num_levels, start_level, options: as for `InfiniteMarioEnv`.
        render_mode: `rgb_array` or `ansi`.

    Raises:
        ConfigError, SimulatorError: an argument is out of bounds, or two contradict each other.
    """

    metadata: dict[str, Any] = _METADATA

    def __init__(
        self,
        num_envs: int = 1,
        *,
        max_episode_steps: int | None = None,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        num_threads: int = 1,
        copy: bool = True,
        observation: str = "tiles",
        action: str = "buttons",
        levels: str | None = None,
        num_levels: int | None = None,
        start_level: int | None = None,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        # Closed until it is complete: Gymnasium 1.0 closes even an environment whose constructor raised.
        self.closed: bool = True
        for name, number in (("num_envs", num_envs), ("num_threads", num_threads)):
            if not isinstance(number, int) or number < 1:
                raise ConfigError(f"{name} must be at least 1, not {number!r:.80}")
        if render_mode == "human":
            raise ConfigError("many games have no window: render_mode is rgb_array or ansi")
        mode = read_mode(autoreset_mode)
        self.num_envs = num_envs
        self.single_action_space: Space[Any] = action_space(action)
        self.action_space: Space[Any] = batch_space(self.single_action_space, num_envs)
        self._renderer = Renderer(render_mode)
        self._games = make_games(
            num_envs,
            observation,
            options,
            mode=_MODES[mode],
            threads=min(num_threads, num_envs),
            max_episode_steps=max_episode_steps,
            levels=resolve_levels(levels, num_levels, start_level),
        )
        self._games.copies = copy
        self.single_observation_space: Space[Any] = observation_space(observation)
        self.observation_space: Space[Any] = batch_space(self.single_observation_space, num_envs)
        self.metadata = {**type(self).metadata, "autoreset_mode": mode}
        self.render_mode = render_mode
        self._view = observation
        self._action = action
        self.copy: bool = copy  # called as Gymnasium's own vector environments do
        self._mode = mode
        self.closed = False

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode in every game, or in those that `options["reset_mask"]`, shape (N,), chooses.

        With a number as `seed`, game `i` is seeded with `seed + i`; see `InfiniteMarioEnv` for the effect.

        Raises:
            ConfigError: there is not one seed per game, or the mask is not N bools with at least one true.
        """
        seed = int(seed) if isinstance(seed, np.integer) else seed
        super().reset(seed=seed if isinstance(seed, int) else None)
        games = self._opened()
        which = self._mask(options)
        seeds = self._seeds(seed)
        for i in np.flatnonzero(which):
            one = seeds[i]
            if one is not None or not games.lanes["begun"][i]:
                generator = self.np_random if one is None else np_random(one)[0]
                games.seed(int(i), int(generator.integers(2**63)))
        games.reset(which)
        return self._observations(), _columns(games.lanes["info"], which)

    def step(
        self, actions: Any
    ) -> tuple[Any, npt.NDArray[np.float64], npt.NDArray[np.bool_], npt.NDArray[np.bool_], dict[str, Any]]:
        """Carry out an action in every game.

        Raises:
            SimulatorError: an action is not in the space, or a game has no episode to step in. No game is
                stepped then.
        """
        games, count = self._opened(), self.num_envs
        rows = read_actions(self._action, actions, count)
        refused = games.step(rows, CHOICES[self._action], self._read)
        if refused >= count:
            game = refused - count
            raise SimulatorError(f"{what_is_wrong_with(self._action, rows[game])} for game {game}")
        if refused >= 0:
            raise SimulatorError(f"game {refused} has no episode to step in: reset it first")
        return self._results

    def _read(self) -> None:
        """Copy the results of a step from the games."""
        lanes = self._games.lanes
        terminated, truncated = lanes["terminated"].copy(), lanes["truncated"].copy()
        infos: dict[str, Any] = {}
        if self._mode is AutoresetMode.SAME_STEP:
            over = terminated | truncated
            if over.any():
                infos = self._final(over)
        infos |= _columns(lanes["info"])
        self._results = self._observations(), lanes["reward"].copy(), terminated, truncated, infos

    def render(self) -> tuple[Any, ...] | None:
        """Render each game as the render mode says."""
        if self.render_mode is None:
            return None
        if not self._games.lanes["begun"].all():
            raise SimulatorError("there is nothing to render: call reset first")
        return tuple(self._renderer.show(self._games.observation(i)) for i in range(self.num_envs))

    def close_extras(self, **_: Any) -> None:
        """End the threads."""
        self._games.close()

    def _opened(self) -> Games:
        if self.closed:
            raise SimulatorError("the environment is closed: make another")
        return self._games

    def _observations(self) -> Any:
        return unpack(self._view, *self._games.shown())

    def _mask(self, options: dict[str, Any] | None) -> npt.NDArray[np.bool_]:
        mask = (options or {}).get("reset_mask")
        if mask is None:
            return np.ones(self.num_envs, np.bool_)
        good = isinstance(mask, np.ndarray) and mask.dtype == np.bool_ and mask.shape == (self.num_envs,)
        if not good or not mask.any():
            raise ConfigError(
                f"options['reset_mask'] is an array of {self.num_envs} bools, one of them true; "
                f"received {mask!r:.80}"
            )
        chosen: npt.NDArray[np.bool_] = mask
        return chosen

    def _seeds(self, seed: int | Sequence[int | None] | None) -> list[int | None]:
        if seed is None:
            return [None] * self.num_envs
        if isinstance(seed, int):
            return [seed + i for i in range(self.num_envs)]
        if len(seed) != self.num_envs:
            raise ConfigError(f"expected a seed for each of {self.num_envs} games; received {len(seed)}")
        return [None if one is None else int(one) for one in seed]

    def _final(self, over: npt.NDArray[np.bool_]) -> dict[str, Any]:
        """Return the final observations and infos of episodes that are over, as Gymnasium names them."""
        games = self._games
        last = np.full(self.num_envs, None, object)
        for i in np.flatnonzero(over):
            last[i] = unpack(self._view, games.final_cells[i].copy(), games.final_reals[i].copy())
        final_info = _columns(games.lanes["final_info"], over)
        return {"final_obs": last, "_final_obs": over, "final_info": final_info, "_final_info": over.copy()}


def _columns(infos: npt.NDArray[np.int64], which: npt.NDArray[np.bool_] | None = None) -> dict[str, Any]:
    """Return rows of infos in the form of Gymnasium's vector environments: by name, each with a mask.

    Args:
        infos: the infos of all games, shape (N, 5).
        which: the mask, shape (N,), of the games whose infos count; None for all.
    """
    numbers = infos.T.copy()
    masks = np.empty(numbers.shape, np.bool_)
    masks[:] = True if which is None else which
    if which is not None:
        numbers *= which
    columns = [*numbers[:_FLAGS].astype(np.bool_), *numbers[_FLAGS:]]
    return dict(zip(_KEYS, [*columns, *masks], strict=True))
