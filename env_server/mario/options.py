"""The options of `InfiniteMario`: what each means, its bounds and its unit."""

from __future__ import annotations

from typing import Annotated

from env_server.mario.parameters import INSTANCES, MDPS
from glue.options import Option

__all__ = [
    "AccelFall",
    "Alpha",
    "Instance",
    "JumpTime",
    "LevelDifficulty",
    "LevelSeed",
    "LevelType",
    "LevelWidth",
    "MaxTrialSteps",
    "Mdp",
    "Render",
    "RewardCoin",
    "RewardDeath",
    "RewardGoal",
    "RewardKill",
    "RewardStep",
    "SlidejumpTime",
    "SpeedJump",
    "SpeedRun",
    "SpeedSlidejump",
    "SpeedWalk",
    "StartTicks",
    "Velocity",
]

Instance = Annotated[
    int, Option("published set of all parameters except the level's", low=0, high=INSTANCES - 1)
]
Mdp = Annotated[str | None, Option("published task, level included, instead of an instance", choices=MDPS)]
LevelSeed = Annotated[int | None, Option("seed of the level, 121 by default", low=-(2**31), high=2**31 - 1)]
LevelType = Annotated[
    int | None, Option("0 overground, 1 underground, 2 castle; 0 by default", low=0, high=2)
]
LevelDifficulty = Annotated[
    int | None, Option("the higher, the more gaps, pipes and enemies; 0 by default", low=0, high=100)
]
LevelWidth = Annotated[
    int | None,
    Option("width of the level, to which 50 are added; 320 by default", low=0, high=2000, unit="tiles"),
]
MaxTrialSteps = Annotated[
    int | None, Option("steps until Mario dies, 1000 by default", low=1, high=10**9, unit="steps")
]
RewardGoal = Annotated[
    float | None, Option("reward for passing the goal, 100 by default", low=-1e9, high=1e9)
]
RewardDeath = Annotated[float | None, Option("reward for dying, -10 by default", low=-1e9, high=1e9)]
RewardStep = Annotated[float | None, Option("reward for each step, -0.01 by default", low=-1e9, high=1e9)]
RewardCoin = Annotated[float | None, Option("reward for each coin, 1 by default", low=-1e9, high=1e9)]
RewardKill = Annotated[float | None, Option("reward for each enemy killed, 1 by default", low=-1e9, high=1e9)]
SpeedWalk = Annotated[
    float | None, Option("acceleration walking, 0.6 by default", low=0, high=16, unit="pixels/tick²")
]
SpeedRun = Annotated[
    float | None, Option("acceleration running, 1.2 by default", low=0, high=16, unit="pixels/tick²")
]
SpeedJump = Annotated[
    float | None,
    Option("speed of a jump per jump count, -1.9 by default", low=-16, high=16, unit="pixels/tick"),
]
SpeedSlidejump = Annotated[
    float | None, Option("the same for jumps off a wall, -2 by default", low=-16, high=16, unit="pixels/tick")
]
AccelFall = Annotated[
    float | None, Option("part of the vertical speed kept, 0.82 by default", low=0, high=1, unit="per tick")
]
JumpTime = Annotated[
    int | None, Option("how long a jump goes up, 7 by default", low=-100, high=100, unit="ticks")
]
SlidejumpTime = Annotated[
    int | None,
    Option("the same for jumps off a wall, negative; -6 by default", low=-100, high=100, unit="ticks"),
]
Render = Annotated[
    str,
    Option(
        "when the original draws a frame, which moves the camera and notices the episode's end",
        choices=("tick", "checkin"),
        flag="drawing",
    ),
]
Alpha = Annotated[float, Option("how far into the next tick the frame is", low=0, high=1, unit="ticks")]
StartTicks = Annotated[
    int, Option("time before the very first observation, 5 or 10", low=5, high=10, unit="ticks")
]
Velocity = Annotated[
    str, Option("tiles per step, or what the first binary release reported", choices=("source", "jar"))
]
