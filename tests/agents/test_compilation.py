"""Agents report their compilation once."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from agents.mario.agent import MarioAgent
from agents.mohan2010.flat import TilesAgent
from agents.mohan2010.hierarchical import HierarchicalAgent
from agents.planner.agent import PlannerAgent
from agents.planner.learner import LearningPlannerAgent

ONE_STEP = """
from agents.mario.sample import SampleAgent  # there is least to compile of it
agent = SampleAgent()
agent.agent_init({task_spec!r})
print("ready")
"""

LOADED_BY_STEPS = """
import sys
from numba.core.registry import CPUDispatcher
from env_server.mario.environment import InfiniteMario
from {module} import {name}

def loaded():
    return {{
        (function.__module__, function.__name__, str(types))
        for module in list(sys.modules.values())
        if module.__name__.startswith(("agents.", "env_server."))
        for function in vars(module).values()
        if isinstance(function, CPUDispatcher)
        for types in function.overloads
    }}

environment, agent = InfiniteMario(), {name}()
agent.agent_init(environment.env_init())
before = loaded()
assert before
action = agent.agent_start(environment.env_start())
for _ in range(500):
    reward, observation, terminal, *_ = environment.env_step(action)
    if terminal:
        break
    action = agent.agent_step(reward, observation)
agent.agent_end(reward)
print(sorted(loaded() - before))
"""


@pytest.mark.parametrize(
    "kind", [TilesAgent, HierarchicalAgent, PlannerAgent, LearningPlannerAgent], ids=lambda kind: kind.name
)
def test_no_step_waits_for_the_compiler(kind: type[MarioAgent]) -> None:
    script = LOADED_BY_STEPS.format(module=kind.__module__, name=kind.__name__)
    run = subprocess.run(
        [sys.executable, "-W", "ignore", "-c", script],
        cwd=Path(__file__).parents[2],
        capture_output=True,
        text=True,
        check=True,
    )
    assert run.stdout == "[]\n"


def test_what_is_compiled_says_so_once_and_is_kept(task_spec: str, tmp_path: Path) -> None:
    said = [
        subprocess.run(
            [sys.executable, "-W", "ignore", "-c", ONE_STEP.format(task_spec=task_spec)],
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)},
            cwd=Path(__file__).parents[2],
            capture_output=True,
            text=True,
            check=True,
        )
        for _ in range(2)
    ]
    assert [run.stdout for run in said] == ["ready\n"] * 2
    assert ["compiling the agent" in run.stderr for run in said] == [True, False]
