"""Compile the simulator and the agents once, before several processes of tests need them.

A program: `python -m tests.compile`. The machine code is kept on disk, so a second time does nothing.
"""

from __future__ import annotations

from agents.mario.sample import SampleAgent
from agents.mohan2010.flat import TilesAgent
from agents.mohan2010.hierarchical import HierarchicalAgent
from env_server.gym import InfiniteMarioEnv
from env_server.mario.batch_environment import InfiniteMarioBatch
from env_server.mario.environment import InfiniteMario

if __name__ == "__main__":
    environment = InfiniteMario(max_trial_steps=1)
    InfiniteMarioBatch(environment, 1).env_init()
    InfiniteMarioEnv().close()
    for agent in (HierarchicalAgent(), TilesAgent(), SampleAgent()):
        agent.agent_init(environment.env_init())
