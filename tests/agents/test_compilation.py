"""Agents compile all that they need before an episode."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]

LOADED_BY_STEPS = """
import os, sys
from numba.core.registry import CPUDispatcher
from agents.mohan2010.flat import TilesAgent
from agents.mohan2010.hierarchical import HierarchicalAgent
from agents.planner.agent import PlannerAgent
from agents.planner.learner import LearningPlannerAgent
from env_server.mario.environment import InfiniteMario
from glue.engine.local import local

def loaded():
    return {
        (function.__module__, function.__name__, str(types))
        for module in list(sys.modules.values())
        if module.__name__.startswith(("agents.", "env_server."))
        for function in vars(module).values()
        if isinstance(function, CPUDispatcher)
        for types in function.overloads
    }

for kind in TilesAgent, HierarchicalAgent, PlannerAgent, LearningPlannerAgent:
    if os.fork():  # each begins with nothing loaded
        os.wait()
        continue
    agent = kind()
    glue = local(agent, InfiniteMario())
    glue.rl_init()
    before = loaded()
    assert before
    glue.rl_episode(80)
    agent.agent_end(0.0)
    print(kind.name, sorted(loaded() - before), flush=True)
    os._exit(0)
"""


def test_no_step_waits_for_the_compiler() -> None:
    command = [sys.executable, "-W", "ignore", "-c", LOADED_BY_STEPS]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout == "tiles []\nhierarchical []\nplanner []\nplanner-learns []\n", done.stderr
