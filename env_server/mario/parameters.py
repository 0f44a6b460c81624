"""The parameters of a task, and the published sets of them: ten instances, Proving and Testing 1 to 10.

`tasks.json` holds the sets; each lists only its differences from the defaults.
Source: RL-Competition 2009, Infinite Mario's parameter presets and its proving and testing MDPs.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import Field, asdict, dataclass, fields, make_dataclass, replace
from dataclasses import field as dataclass_field
from functools import cache, partial
from importlib import resources
from typing import Annotated, Any, Final, get_args, get_type_hints

from env_server.mario.pictures import Picture
from env_server.mario.sim.state import World
from glue.options import Option

INSTANCES: Final = 10
"""Number of instances, which are numbered from 0."""
MDPS: Final = tuple(f"{phase}-{number}" for phase in ("proving", "testing") for number in range(1, 11))
"""The names of the published MDPs."""


_Reward = partial(Option, low=-1e9, high=1e9)
_Acceleration = partial(Option, low=0, high=16, unit="pixels/tick²")
_Speed = partial(Option, low=-16, high=16, unit="pixels/tick")
_Ticks = partial(Option, low=-100, high=100, unit="ticks")


@dataclass(frozen=True, slots=True)
class Parameters:
    """A complete task, by default instance 0.

    The options, their checks and the table in docs/mario.md are made from these fields.
    """

    level_seed: Annotated[int, Option("seed of the level", low=-(2**31), high=2**31 - 1)] = 121
    level_type: Annotated[int, Option("0 overground, 1 underground, 2 castle", low=0, high=2)] = 0
    level_difficulty: Annotated[
        int, Option("the higher, the more gaps, pipes and enemies", low=0, high=100)
    ] = 0
    level_width: Annotated[
        int, Option("width of the level, to which 50 are added", low=0, high=2000, unit="tiles")
    ] = 320
    max_trial_steps: Annotated[int, Option("steps until Mario dies", low=1, high=10**9, unit="steps")] = 1000
    reward_goal: Annotated[float, _Reward("reward for passing the goal")] = 100.0
    reward_death: Annotated[float, _Reward("reward for dying")] = -10.0
    reward_step: Annotated[float, _Reward("reward for each step")] = -0.01
    reward_coin: Annotated[float, _Reward("reward for each coin")] = 1.0
    reward_kill: Annotated[float, _Reward("reward for each enemy killed")] = 1.0
    speed_walk: Annotated[float, _Acceleration("acceleration walking")] = 0.6
    speed_run: Annotated[float, _Acceleration("acceleration running")] = 1.2
    speed_jump: Annotated[float, _Speed("speed of a jump per remaining jump count")] = -1.9
    speed_slidejump: Annotated[float, _Speed("the same for jumps off a wall")] = -2.0
    accel_fall: Annotated[
        float, Option("share of the vertical speed that is kept", low=0, high=1, unit="per tick")
    ] = 0.82
    jump_time: Annotated[int, _Ticks("time for which a jump rises")] = 7
    slidejump_time: Annotated[int, _Ticks("the same for jumps off a wall, negative")] = -6
    render: Annotated[
        str,
        Option(
            "when the original draws a frame, which moves the camera and notices the episode's end",
            choices=("tick", "checkin"),
            flag="drawing",
        ),
    ] = "tick"
    alpha: Annotated[
        float, Option("how far into the next tick the frame is", low=0, high=1, unit="ticks")
    ] = 1.0
    start_ticks: Annotated[
        int, Option("time before the very first observation, 5 or 10", low=5, high=10, unit="ticks")
    ] = 5
    velocity: Annotated[
        str, Option("tiles per step, or as the first binary release reported it", choices=("source", "jar"))
    ] = "source"
    level: Picture | None = None  # in place of a level made from a seed; its `parameters` are in force

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


@dataclass(frozen=True, kw_only=True)
class _Published:
    instance: Annotated[
        int, Option("published set of all parameters except the level's", low=0, high=INSTANCES - 1)
    ] = 0
    mdp: Annotated[
        str | None, Option("published task, level included, in place of an instance", choices=MDPS)
    ] = None
    level: Annotated[str | None, Option("file of a level, a text picture, in place of a seed")] = None
    level_digest: Annotated[str | None, Option("SHA-256 that this file must have, in hexadecimal")] = None
    extras: Annotated[bool, Option("tell the experiment of coins, kills, distance, death and mode")] = False


def _optional(field: Field[Any]) -> tuple[str, Any, Any]:
    """Return a parameter as an option whose default comes from the instance or MDP."""
    kind, option = get_args(get_type_hints(Parameters, include_extras=True)[field.name])
    about = replace(option, help=f"{option.help}; {field.default} by default")
    return field.name, Annotated[kind | None, about], dataclass_field(default=None)


Options: Final = make_dataclass(
    "Options",
    [_optional(field) for field in fields(Parameters) if field.name != "level"],
    bases=(_Published,),
    frozen=True,
    kw_only=True,
)
"""The options of `InfiniteMario`: those of `_Published`, and each parameter; None takes it from those."""


def resolve(
    given: Mapping[str, int | float | str | Picture], *, instance: int = 0, mdp: str | None = None
) -> Parameters:
    """Return the task of an MDP, or else of an instance, overridden by the parameters `given` by name.

    Raises:
        KeyError: there is no such instance or MDP.
    """
    phase, number = mdp.split("-") if mdp else ("instances", str(instance))
    return Parameters(**{**_tasks()[phase][number], **given})


@cache
def _tasks() -> dict[str, dict[str, Any]]:
    text = resources.files("env_server").joinpath("tasks.json").read_text(encoding="utf-8")
    tasks: dict[str, dict[str, Any]] = json.loads(text)
    return tasks
