"""The compiled code on disk: said when it is made, read when it is there, made anew when a rule changes."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType

import pytest

ENTRY = """
from glue.compiled.jit import entry
from rules.helper import factor

@entry
def scaled(number):
    return factor() * number
"""
HELPER = """
from glue.compiled.jit import jit

@jit
def factor():
    return FACTOR
"""
PROGRAM = """
from glue.compiled.jit import announce_compilation
from rules.scaling import scaled

with announce_compilation("the rules"):
    print(scaled(21))
"""


@pytest.fixture
def program(tmp_path: Path) -> Path:
    """A package with an entry in one module and what it calls in another, and a program that uses it."""
    package = tmp_path / "rules"
    package.mkdir()
    (package / "__init__.py").touch()
    (package / "scaling.py").write_text(ENTRY)
    (package / "helper.py").write_text(HELPER.replace("FACTOR", "2"))
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    return program


def run(program: Path, factor: int = 2, environment: Mapping[str, str] = MappingProxyType({})) -> str:
    """Run the program with a rule of `factor`; check its result and return what it prints to stderr."""
    helper = program.parent / "rules" / "helper.py"
    if (rule := HELPER.replace("FACTOR", str(factor))) != helper.read_text():
        helper.write_text(rule)
    done = subprocess.run(
        [sys.executable, "-W", "error", str(program)],
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"{factor * 21}\n"
    return done.stderr


def test_compiling_is_said_once_for_each_state_of_the_code(program: Path) -> None:
    said = run(program)
    before, after = said.splitlines()
    assert before == "compiling the rules, this once ..."
    assert re.fullmatch(r"compiled the rules in \d+ s", after)
    assert "compiling" in run(program, environment={"NUMBA_BOUNDSCHECK": "1"})
    assert run(program) == ""
    assert "compiling" in run(program, factor=3)  # a rule in another module is changed
    assert run(program, factor=3) == ""


def test_without_a_folder_to_write_to_it_still_runs(program: Path, tmp_path: Path) -> None:
    (tmp_path / "rules" / "__pycache__").write_text("a file, so that no folder can be made")
    nowhere = {"HOME": "/dev/null", "XDG_CACHE_HOME": "/dev/null", "NUMBA_CACHE_DIR": ""}
    assert "compiling" in run(program, environment=nowhere)
    assert "compiling" in run(program, environment=nowhere)


def test_without_compiling_nothing_is_said(program: Path) -> None:
    assert run(program, environment={"NUMBA_DISABLE_JIT": "1"}) == ""
