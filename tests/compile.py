"""Compile the simulator and the agents once, before several test processes need them.

The programs `python -m tests.compile games` and `python -m tests.compile agents` may run at the same time.
Machine code is cached on disk, so a second run does nothing.
"""

from __future__ import annotations

import sys
from typing import Any, cast

import numpy as np

from agents.mario.objects import look
from agents.mario.observation import Screen, read
from agents.mario.sample import SampleAgent
from agents.mario.scene import Scene, Senses
from agents.mohan2010.flat import TilesAgent
from agents.mohan2010.hierarchical import HierarchicalAgent
from agents.planner.agent import PlannerAgent
from env_server.gym import InfiniteMarioEnv
from env_server.mario.environment import InfiniteMario
from env_server.mario.many.environment import InfiniteMarioBatch
from env_server.mario.observation import BODY_SIZE, encode
from env_server.mario.sim.blocks import hit_block
from env_server.mario.sim.step import tick
from glue.compiled.records import new
from glue.types import Observation


def games() -> None:
    environment = InfiniteMario(max_trial_steps=1)
    environment.env_init()
    environment.env_start()
    InfiniteMarioBatch(environment, 1).env_init()
    InfiniteMarioEnv().close()
    world, level = environment.game.world, environment.game.level_map
    tick(world, level)
    hit_block(world, level, 5, 9, False)
    encode(world, level, np.zeros(BODY_SIZE, np.uint8))


def agents() -> None:
    task_spec = "VERSION Mario-v1 PROBLEMTYPE episodic DISCOUNTFACTOR 1 ACTIONS INTS (-1 1) (2 0 1) REWARDS"
    for agent in (HierarchicalAgent(), TilesAgent(), SampleAgent(), PlannerAgent()):
        agent.agent_init(task_spec)
    scene, senses, screen = (cast(Any, new(record)[0]) for record in (Scene, Senses, Screen))
    body = Observation().body
    look(scene, senses, body)
    read(body, screen)


if __name__ == "__main__":
    {"games": games, "agents": agents}[sys.argv[1]]()
