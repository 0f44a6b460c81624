"""Compiled code on disk: compilation is announced, and happens again only when a rule changes."""

from __future__ import annotations

import fcntl
import io
import os
import re
import runpy
import signal
import subprocess
import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import pytest

from glue.compiled.jit import _Announcement
from tests import forked

ROOT = Path(__file__).parents[3]
TIMEOUT = 60.0

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
from player.scaling import scaled

with announce_compilation("the rules"):
    print(scaled(21))
"""
WIDTHS = """
import numpy as np
from glue.compiled.jit import entry, jit

@jit
def twice(number):
    return 2 * number

@entry
def doubled(numbers):
    return twice(1) + twice(2) + twice(numbers[0]) + twice(len(numbers))

result = doubled(np.array([2**30], np.int32))
"""


@pytest.fixture
def program(tmp_path: Path) -> Path:
    """A package with an entry that calls a function of another package, and a program that uses the entry."""
    for package, module, code in (
        ("player", "scaling.py", ENTRY),
        ("rules", "helper.py", HELPER.replace("FACTOR", "2")),
    ):
        (tmp_path / package).mkdir()
        (tmp_path / package / "__init__.py").touch()
        (tmp_path / package / module).write_text(code)
    program = tmp_path / "program.py"
    program.write_text(PROGRAM)
    return program


def run(program: Path, factor: int = 2, environment: Mapping[str, str] = MappingProxyType({})) -> str:
    """Run the program with a rule of `factor`; check its result and return its stderr."""
    helper = program.parent / "rules" / "helper.py"
    if (rule := HELPER.replace("FACTOR", str(factor))) != helper.read_text():
        helper.write_text(rule)
    if environment:  # numba reads it when it is imported
        command = [sys.executable, "-W", "error", str(program)]
        settings = {**os.environ, **environment}
        done = subprocess.run(command, env=settings, capture_output=True, text=True, timeout=TIMEOUT)
    else:
        settings = {**os.environ, "PYTHONPATH": str(program.parent)}
        done = forked.run(str(program), cwd=program.parent, env=settings)
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"{factor * 21}\n"
    return done.stderr


def test_compiling_is_said_once_for_each_state_of_the_code(program: Path) -> None:
    said = run(program)
    before, after = said.splitlines()
    assert before == "compiling the rules, this once ..."
    assert re.fullmatch(r"compiled the rules in \d+ s", after)
    assert run(program) == ""
    # A rule in another package has changed. Within a second Python notices only another size of a module.
    assert "compiling" in run(program, factor=10)


@pytest.mark.stage("proof")
@pytest.mark.proof
def test_code_that_checks_bounds_is_kept_beside_the_other(program: Path) -> None:
    run(program)
    assert "compiling" in run(program, environment={"NUMBA_BOUNDSCHECK": "1"})
    assert run(program) == ""


def test_without_a_folder_to_write_to_it_still_runs(program: Path, tmp_path: Path) -> None:
    (tmp_path / "player" / "__pycache__").write_text("a file, so that no folder can be made")
    nowhere = {"HOME": "/dev/null", "XDG_CACHE_HOME": "/dev/null", "NUMBA_CACHE_DIR": ""}
    assert "compiling" in run(program, environment=nowhere)


def test_a_function_is_compiled_once_for_all_widths_of_integers_and_constants(tmp_path: Path) -> None:
    (tmp_path / "widths.py").write_text(WIDTHS)
    done = runpy.run_path(str(tmp_path / "widths.py"))
    assert done["result"] == 2 + 4 + 2**31 + 2
    assert len(done["twice"].overloads) == 1


def test_in_a_terminal_the_time_passed_is_shown_while_it_compiles(monkeypatch: pytest.MonkeyPatch) -> None:
    shown = threading.Event()

    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

        def write(self, text: str) -> int:
            if re.fullmatch(r"  \| 0 s\x1b\[K", text):
                shown.set()
            return super().write(text)

    monkeypatch.setattr("sys.stderr", Terminal())
    monkeypatch.setattr("glue.compiled.jit._SPIN_SECONDS", 0.001)
    announcement = _Announcement("the rules")
    announcement.on_start(None)
    assert shown.wait(60)
    announcement.over.set()


def test_one_process_compiles_and_the_others_wait_and_say_so(tmp_path: Path) -> None:
    (tmp_path / "rules.py").write_text(
        "from glue.compiled.jit import announce_compilation, entry\n"
        "@entry\ndef one(x):\n    return x + 1\n"
        "print(one._cache.cache_path, flush=True)\n"
        "input()\n"
        "with announce_compilation('the rules'):\n    print(one(1), flush=True)\n"
    )
    settings = {**os.environ, "PYTHONPATH": str(ROOT), "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    pipes: Any = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}
    with subprocess.Popen(
        [sys.executable, "-u", "rules.py"], cwd=tmp_path, env=settings, text=True, **pipes
    ) as other:
        folder = Path(other.stdout.readline().strip())  # type: ignore[union-attr]
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / "one.lock").open("w") as lock:
            fcntl.flock(lock, fcntl.LOCK_EX)
            print(file=other.stdin, flush=True)
            assert "another process is compiling one" in other.stderr.readline()  # type: ignore[union-attr]
        printed, said = other.communicate(timeout=TIMEOUT)
    assert printed == "2\n"
    assert "compiling the rules, this once ..." in said
    assert other.returncode == 0


SPINNING = """
import click
import numpy as np
from glue.compiled.jit import announce_compilation, entry

@entry
def spin(x):  # as LLVM, it does not return for a signal
    while x[0] < 2:
        x[0] = 1 - x[0]

@click.command()
def main():
    with announce_compilation("the rules"):
        spin(np.array([2]))
        print("ready", flush=True)
        spin(np.array([0]))
"""


@pytest.mark.parametrize(
    "number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.stage("proof"))]
)
def test_a_signal_ends_a_command_within_machine_code(number: signal.Signals, tmp_path: Path) -> None:
    (tmp_path / "spinning.py").write_text(SPINNING)
    command = [sys.executable, "-c", "from glue.cli.entry import start; start('spinning', 'main')"]
    settings = {**os.environ, "PYTHONPATH": f"{ROOT}:{tmp_path}"}
    with subprocess.Popen(command, cwd=tmp_path, env=settings, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        process.send_signal(number)
        assert process.wait(TIMEOUT) == 128 + number
