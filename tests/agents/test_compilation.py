"""Agents say that they are compiled, once."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

ONE_STEP = """
from agents.mario.sample import SampleAgent  # there is least to compile of it
agent = SampleAgent()
agent.agent_init({task_spec!r})
print("ready")
"""


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
