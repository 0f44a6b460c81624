"""Compiled code and record layouts."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np

from agents._jit import Flag, Int, Real, layout, new

ONE_STEP = """
from agents.flat import TilesAgent
agent = TilesAgent()
agent.agent_init({task_spec!r})
print(agent.agent_message("epsilon"))
"""


class Inner:
    a: Int
    b: Flag


class Outer:
    first: Annotated[Inner, Inner]
    many: Annotated[Sequence[Inner], Inner, (2, 3)]
    number: Real


def test_a_record_is_laid_out_as_its_class_says() -> None:
    outer = new(Outer)
    assert outer.shape == (1,)
    assert outer.dtype.names == ("first", "many", "number")
    assert outer["many"].shape == (1, 2, 3)
    assert outer["first"].dtype.names == ("a", "b")
    assert outer["first"]["b"].dtype == np.bool_
    assert layout(Outer) is layout(Outer)


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
    assert [run.stdout for run in said] == ["0.1\n"] * 2
    assert ["compiling the agent" in run.stderr for run in said] == [True, False]
