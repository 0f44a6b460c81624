"""Agents compile all that they need before an episode, and say so."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]

ONE_STEP = """
from agents.mario.sample import SampleAgent  # there is least to compile of it
SampleAgent().agent_init({task_spec!r})
"""

LOADED_BY_STEPS = """
import os, sys
from numba.core.registry import CPUDispatcher
from agents.mohan2010.flat import TilesAgent
from agents.mohan2010.hierarchical import HierarchicalAgent
from agents.planner.agent import PlannerAgent
from agents.planner.learner import LearningPlannerAgent
from env_server.mario.environment import InfiniteMario

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
    environment, agent = InfiniteMario(), kind()
    agent.agent_init(environment.env_init())
    before = loaded()
    assert before
    action = agent.agent_start(environment.env_start())
    for _ in range(200):
        reward, observation, terminal, *_ = environment.env_step(action)
        if terminal:
            break
        action = agent.agent_step(reward, observation)
    agent.agent_end(reward)
    print(kind.name, sorted(loaded() - before), flush=True)
    os._exit(0)
"""


def run(script: str, **environment: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-W", "ignore", "-c", script]
    settings = {**os.environ, **environment}
    return subprocess.run(command, cwd=ROOT, env=settings, capture_output=True, text=True, check=True)


def test_no_step_waits_for_the_compiler() -> None:
    done = run(LOADED_BY_STEPS)
    assert done.stdout == "tiles []\nhierarchical []\nplanner []\nplanner-learns []\n", done.stderr


def test_an_agent_says_what_it_compiles(task_spec: str, tmp_path: Path) -> None:
    done = run(ONE_STEP.format(task_spec=task_spec), NUMBA_CACHE_DIR=str(tmp_path))
    assert "compiling the agent sample, this once" in done.stderr
