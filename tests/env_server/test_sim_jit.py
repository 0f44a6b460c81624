"""The compiled code on disk: said when it is made, read when it is there, made anew when a rule changes."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
import sys
from env_server.sim import _jit
_jit._SOURCES += sys.argv[1]

@_jit.entry
def double(number):
    return 2 * number

with _jit.say_when_compiling():
    assert double(21) == 42
"""


@pytest.fixture
def program(tmp_path: Path) -> Path:
    path = tmp_path / "program.py"
    path.write_text(PROGRAM)
    return path


def run(program: Path, rules: str = "", **environment: str) -> str:
    """Run the program; return what it says on stderr."""
    done = subprocess.run(
        [sys.executable, "-W", "error", str(program), rules],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stderr


def test_compiling_is_said_once(program: Path) -> None:
    said = run(program)
    assert said.startswith("mario: compiling the simulator, this once ... done in ")
    assert len(said.splitlines()) == 1
    assert run(program) == ""


def test_changed_rules_are_compiled_anew(program: Path) -> None:
    run(program)
    assert "compiling" in run(program, "other rules")
    assert run(program, "other rules") == ""


def test_bounds_check_has_code_of_its_own(program: Path) -> None:
    run(program)
    assert "compiling" in run(program, NUMBA_BOUNDSCHECK="1")
    assert run(program) == ""


def test_without_a_folder_to_write_to_it_still_runs(program: Path, tmp_path: Path) -> None:
    (tmp_path / "__pycache__").write_text("a file, so that no folder can be made")
    nowhere = {"HOME": "/dev/null", "XDG_CACHE_HOME": "/dev/null", "NUMBA_CACHE_DIR": ""}
    assert "compiling" in run(program, **nowhere)
    assert "compiling" in run(program, **nowhere)


def test_without_compiling_nothing_is_said(program: Path) -> None:
    assert run(program, NUMBA_DISABLE_JIT="1") == ""
