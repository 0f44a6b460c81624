"""One game of Infinite Mario as a `gymnasium.Env`."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

import gymnasium
import numpy as np
import numpy.typing as npt

from env_server.gym.rendering import FPS, RENDER_MODES, Renderer, usable_modes
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
from env_server.mario.many.games import INFOS
from glue.errors import SimulatorError

_METADATA: Final = {"render_modes": [*RENDER_MODES], "render_fps": FPS}


@dataclass(frozen=True, slots=True)
class GameState:
    """The state of a game, from `clone_state`; it is not portable to other versions of the program."""

    arrays: tuple[npt.NDArray[Any], ...]


class InfiniteMarioEnv(gymnasium.Env[Any, Any]):  # type: ignore[misc]
    """Infinite Mario of the RL-Competition 2009.

    Args:
        observation: `tiles`, `planes`, `pixels` or `raw`: see docs/gymnasium.md.
        action: `buttons`, MultiDiscrete([3, 2, 2]) of direction (0 left, 1 neither, 2 right), jump and run;
            or `discrete`, Discrete(12), whose action is 4 * direction + 2 * jump + run.
        levels: the name of a set of levels; each episode is played on one of them.
        num_levels, start_level: instead of a set, `num_levels` levels from number `start_level` on.
        render_mode: `rgb_array`, `ansi` or `human`.
        options: any parameter of the game, as for `glue-env mario`. A given level type or difficulty holds
            for all levels of a set.

    Mario's own step limit, `max_trial_steps`, pays the reward of death and terminates the episode; then
    `info["timeout"]` is true.

    Raises:
        ConfigError, SimulatorError: an argument is out of bounds, or two contradict each other.
    """

    metadata: dict[str, Any] = _METADATA

    def __init__(
        self,
        *,
        observation: str = "tiles",
        action: str = "buttons",
        levels: str | None = None,
        num_levels: int | None = None,
        start_level: int | None = None,
        render_mode: str | None = None,
        **options: Any,
    ) -> None:
        self.action_space: gymnasium.Space[Any] = action_space(action)
        self._renderer = Renderer(render_mode)
        chosen = resolve_levels(levels, num_levels, start_level)
        self._games = make_games(1, observation, options, levels=chosen)
        self.observation_space: gymnasium.Space[Any] = observation_space(observation)
        # The class lists every mode, for gymnasium.make; an instance lists those that work here.
        self.metadata = {**type(self).metadata, "render_modes": usable_modes()}
        self.render_mode = render_mode
        self._view = observation
        self._action = action
        self._seeded = False

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        """Begin an episode.

        With a seed, nothing of earlier episodes remains; without a seed, as in the original, buttons that the
        last episode left pressed are still held in the first tick.
        """
        super().reset(seed=seed)
        if seed is not None or not self._seeded:
            self._games.seed(0, int(self.np_random.integers(2**63)))
            self._seeded = True
        self._games.reset(np.ones(1, np.bool_))
        self._show()
        return self._observation(), self._info()

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        """Hold the buttons of `action` for five ticks of the game.

        When an episode terminates, its last observation repeats the previous one.

        Raises:
            SimulatorError: the action is not in the space, or there is no episode to step in.
        """
        games = self._games
        rows = read_actions(self._action, action, 0)
        refused = games.step(rows, CHOICES[self._action])
        if refused == 0:
            raise SimulatorError("a step needs an episode: call reset first, and again after each end")
        if refused > 0:
            raise SimulatorError(what_is_wrong_with(self._action, rows[0]))
        self._show()
        lane = games.lanes[0]
        return self._observation(), float(lane["reward"]), bool(lane["terminated"]), False, self._info()

    def render(self) -> Any:
        """Render the game as the render mode says; see Gymnasium.

        Raises:
            SimulatorError: there is no episode yet.
        """
        if self.render_mode is None:
            gymnasium.logger.warn(
                "render() was called without a render mode: gymnasium.make(..., render_mode='rgb_array')"
            )
            return None
        if not self._games.lanes["begun"][0]:
            raise SimulatorError("there is nothing to render: call reset first")
        return None if self.render_mode == "human" else self._renderer.show(self._games.observation(0))

    def close(self) -> None:
        """Close the window, if there is one."""
        self._games.close()
        self._renderer.close()

    def clone_state(self) -> GameState:
        """Return the state of the game and of its choice of levels, for `restore_state`."""
        return GameState(tuple(array.copy() for array in self._arrays()))

    def restore_state(self, state: GameState) -> None:
        """Restore a state that `clone_state` of an environment with the same options returned.

        Raises:
            SimulatorError: `state` is not such a state, or is of an environment with other observations.
        """
        if not isinstance(state, GameState):
            raise SimulatorError(f"expected a state that clone_state returned, not {state!r:.80}")
        pairs = [*zip(self._arrays(), state.arrays, strict=True)]
        if any(ours.shape != theirs.shape or ours.dtype != theirs.dtype for ours, theirs in pairs):
            raise SimulatorError("this state is of an environment with another kind of observation")
        for ours, theirs in pairs:
            ours[:] = theirs
        self._seeded = True

    def _arrays(self) -> tuple[npt.NDArray[Any], ...]:
        games = self._games
        records = games.worlds, games.levels, games.lanes
        return *(array.view(np.uint8) for array in records), games.cells, games.reals

    def _show(self) -> None:
        if self.render_mode == "human":
            self._renderer.show(self._games.observation(0))

    def _observation(self) -> Any:
        return unpack(self._view, self._games.cells[0].copy(), self._games.reals[0].copy())

    def _info(self) -> dict[str, Any]:
        timeout, goal, *level = self._games.lanes["info"][0].tolist()
        return dict(zip(INFOS, (bool(timeout), bool(goal), *level), strict=True))
