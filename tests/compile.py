"""Compile the simulator and the agents once, before several test processes need them.

The programs `python -m tests.compile games` and `python -m tests.compile agents` may run at the same time.
Machine code is cached on disk, so a second run does nothing.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from functools import partial
from typing import Any, Final, cast

import numpy as np

from agents.mario.agent import MarioAgent
from agents.mario.best import BestAgent
from agents.mario.objects import Scene, Senses, look
from agents.mario.observation import Screen, read
from agents.mario.sample import SampleAgent
from agents.mohan2010.flat import TilesAgent
from agents.mohan2010.hierarchical import HierarchicalAgent
from agents.network.agent import NetworkAgent
from agents.planner.agent import PlannerAgent
from agents.planner.learner import LearningPlannerAgent
from env_server.gym import InfiniteMarioEnv
from env_server.mario.environment import InfiniteMario
from env_server.mario.many.environment import InfiniteMarioBatch
from env_server.mario.many.games import SAME_STEP, Games
from env_server.mario.many.views import VIEWS
from env_server.mario.observation import BODY_SIZE, encode
from env_server.mario.sim.blocks import hit_block
from env_server.mario.sim.step import tick
from glue.compiled.records import new
from glue.types import Action, Observation

AGENTS: Final[tuple[type[MarioAgent], ...]] = (
    *(HierarchicalAgent, TilesAgent, SampleAgent, BestAgent, NetworkAgent, PlannerAgent),
    LearningPlannerAgent,
)


def _game() -> None:
    environment = InfiniteMario(max_trial_steps=1)
    environment.env_init()
    environment.env_start()
    world, level = environment.game.world, environment.game.level_map
    tick(world, level)
    hit_block(world, level, 5, 9, False)
    encode(world, level, np.zeros(BODY_SIZE, np.uint8))


def _many_games() -> Games:
    games = Games([InfiniteMario().parameters], VIEWS["tiles"], SAME_STEP)
    games.seed(0, 0)
    games.reset()
    games.step(np.array([[4]]), np.array([1]))
    return games


def _observations() -> None:
    scene, senses, screen = (cast(Any, new(record)[0]) for record in (Scene, Senses, Screen))
    body = Observation().body
    look(scene, senses, body)
    read(body, screen)


def _agent(kind: Callable[[], MarioAgent]) -> None:
    agent, environment = kind(), InfiniteMario()
    agent.agent_init(environment.env_init())
    agent.agent_start(environment.env_start())
    reward, observation, *_ = environment.env_step(Action([1, 0, 0]))
    agent.agent_step(reward, observation)
    agent.agent_end(reward)


def _routes() -> None:
    """Plan a route through a level whose goal is on the first screen."""
    agent, environment = PlannerAgent(study=500), InfiniteMario(level_width=15)
    agent.agent_init(environment.env_init())
    agent.agent_start(environment.env_start())


PARTS: Final[dict[str, dict[str, Callable[[], object]]]] = {
    "games": {
        "Infinite Mario": _game,
        "its batches": lambda: InfiniteMarioBatch(InfiniteMario(max_trial_steps=1), 1).env_init(),
        "its Gymnasium environments": lambda: InfiniteMarioEnv().close(),
        "many games": _many_games,
    },
    "agents": {
        "observations": _observations,
        **{f"the agent {kind.name}": partial(_agent, kind) for kind in AGENTS},
        "routes of the planner": _routes,
    },
}


def main(parts: dict[str, Callable[[], object]]) -> None:
    """Compile some parts, with a line for each beside what the program itself says of its compilation."""
    for name, compile_ in parts.items():
        began = time.monotonic()
        compile_()
        print(f"ready: {name}, {time.monotonic() - began:.1f} s", flush=True)


if __name__ == "__main__":
    main(PARTS[sys.argv[1]])
