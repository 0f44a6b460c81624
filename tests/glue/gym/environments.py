"""Gymnasium environments for tests."""

from __future__ import annotations

from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces


class Nested(gymnasium.Env[Any, Any]):  # type: ignore[misc]
    """Random values of a nested space of all kinds; the reward echoes the action."""

    action_space = spaces.Tuple([spaces.Box(-1, 1, (2,), np.float32), spaces.MultiDiscrete([3, 2])])

    def __init__(
        self, length: int = 5, ends: str = "truncated", shift: float = 0.0, on: bool = False
    ) -> None:
        self.observation_space = spaces.Dict(
            picture=spaces.Box(0, 255, (4, 3, 2), np.uint8),
            place=spaces.Box(np.array([-1, -np.inf], np.float32), np.array([1, np.inf], np.float32)),
            extra=spaces.Tuple(
                [spaces.Discrete(3, start=-1), spaces.MultiBinary((2, 2)), spaces.Box(0, 9, (), np.int16)]
            ),
        )
        self._length, self._ends, self._shift, self._on = length, ends, shift, on

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        if seed is not None:
            self.observation_space.seed(seed)
        self._steps = 0
        return self.observation_space.sample(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        self._steps += 1
        over = self._steps == self._length
        reward = float(action[0].sum() + 10 * action[1].sum() + self._shift)
        terminated, truncated = over and self._ends != "truncated", over and self._ends != "terminated"
        return self.observation_space.sample(), reward, terminated, truncated, {}


gymnasium.register("tests/Nested-v0", entry_point=Nested)


class Masked(gymnasium.Env[Any, Any]):  # type: ignore[misc]
    """Two numbers, of which step `i` rewards (i % 3, i % 2); its infos allow these and little else.

    They also have the step and, at the last one, what the episode was worth.
    """

    action_space = spaces.MultiDiscrete([3, 2])
    observation_space = spaces.Discrete(10)

    def __init__(self, length: int = 4) -> None:
        self._length = length

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        self._step, self._total = 0, 0.0
        return self._shown()

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        reward = float(action[0] == self._step % 3) + float(action[1] == self._step % 2)
        self._step += 1
        self._total += reward
        observation, info = self._shown()
        return observation, reward, self._step == self._length, False, info

    def _shown(self) -> tuple[Any, dict[str, Any]]:
        first, second = np.zeros(3, np.int8), np.zeros(2, np.int8)
        if self._step < self._length:
            first[[self._step % 3, (self._step + 1) % 3]] = second[self._step % 2] = 1
        info: dict[str, Any] = {"action_mask": (first, second), "step": np.int64(self._step)}
        info |= {"path": [*range(self._step)], "rich": {"a": 1}}
        if self._step == self._length:
            info["worth"] = self._total
        return self._step, info


gymnasium.register("tests/Masked-v0", entry_point=Masked)
