"""The parameters of a task, and the published sets of them: ten instances, Proving and Testing 1 to 10.

`tasks.json` holds the sets; each says only what differs from the defaults.
Source: RL-Competition 2009, Infinite Mario's parameter presets and its proving and testing MDPs.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import cache
from importlib import resources
from typing import Any, Final

from env_server.mario.sim.state import World

__all__ = ["INSTANCES", "MDPS", "Parameters", "resolve"]

INSTANCES: Final = 10
"""Instances are numbered from 0."""
MDPS: Final = tuple(f"{phase}-{number}" for phase in ("proving", "testing") for number in range(1, 11))
"""The names of the published MDPs."""


@dataclass(frozen=True, slots=True)
class Parameters:
    """A complete task. Units and ranges are with the options of `InfiniteMario`."""

    level_seed: int
    level_type: int
    level_difficulty: int
    level_width: int
    max_trial_steps: int
    reward_goal: float
    reward_death: float
    reward_step: float
    reward_coin: float
    reward_kill: float
    speed_walk: float
    speed_run: float
    speed_jump: float
    speed_slidejump: float
    accel_fall: float
    jump_time: int
    slidejump_time: int
    render: str = "tick"
    alpha: float = 1.0
    start_ticks: int = 5
    velocity: str = "source"

    @property
    def rewards(self) -> tuple[float, float]:
        """The smallest and the largest reward parameter."""
        rewards = (self.reward_goal, self.reward_death, self.reward_step, self.reward_coin, self.reward_kill)
        return min(rewards), max(rewards)

    def write_to(self, world: World) -> None:
        """Make this the task of `world`, from its next episode on."""
        for name, value in asdict(self).items():
            if name in World.__annotations__:  # render and velocity are flags there
                setattr(world, name, value)
        world.draws_at_checkins = self.render == "checkin"
        world.velocity_of_jar = self.velocity == "jar"


def resolve(
    given: Mapping[str, int | float | str], *, instance: int = 0, mdp: str | None = None
) -> Parameters:
    """Return the task of an MDP, or else of an instance, with what is `given` by name put in its place.

    Raises:
        KeyError: there is no such instance or MDP.
    """
    tasks = _tasks()
    task: dict[str, Any] = {**tasks["defaults"]}
    if mdp:
        phase, number = mdp.split("-")
        task.update(tasks[phase][number])
    else:
        task.update(tasks["instances"][str(instance)])
    task.update(given)
    return Parameters(**task)


@cache
def _tasks() -> dict[str, dict[str, Any]]:
    text = resources.files("env_server").joinpath("tasks.json").read_text(encoding="utf-8")
    tasks: dict[str, dict[str, Any]] = json.loads(text)
    return tasks
