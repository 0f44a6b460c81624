"""Commands in odd surroundings: no traceback, and no directory that is lost."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.forked import BIN

EXPERIMENT = "glue-experiment --env mines --agent sarsa --episodes 2 --max-steps 9 --in-process --out out"

SURROUNDINGS = {
    "closed output": '"$@" >&-',
    "closed streams": '"$@" <&- >&- 2>log',
    "no directory": 'mkdir gone && cd gone && rmdir ../gone && "$@"',
    "ASCII": 'LC_ALL=POSIX PYTHONCOERCECLOCALE=0 PYTHONUTF8=0 "$@"',
    "names that are no text": 'cd "$(printf "na\\357ve")" && "$@"',
    "no assertions and docstrings": 'PYTHONOPTIMIZE=2 "$@"',
    "warnings are errors": 'PYTHONWARNINGS=error "$@"',
}
HEAVY = pytest.mark.stage("attacks")


@pytest.mark.parametrize("where", SURROUNDINGS)
@pytest.mark.parametrize(
    "command",
    [
        "glue-results list .",
        pytest.param(EXPERIMENT, marks=HEAVY),
        pytest.param("glue-results show .", marks=HEAVY),
        pytest.param("glue-plot . --out plot.svg", marks=HEAVY),
        pytest.param("glue-keys new hub --dir keys", marks=HEAVY),
        pytest.param("glue-agent sarsa --wait 0.1", marks=HEAVY),
        pytest.param("glue-compile --help", marks=HEAVY),
    ],
)
def test_a_command_ends_in_a_result_or_in_one_line(tmp_path: Path, where: str, command: str) -> None:
    os.mkdir(os.fsencode(tmp_path) + b"/na\xefve")
    name, *arguments = command.split()
    shell = ["sh", "-c", SURROUNDINGS[where], "sh", str(BIN / name), *arguments]
    done = subprocess.run(shell, cwd=tmp_path, capture_output=True, errors="replace", timeout=120)
    shown = done.stderr + ((tmp_path / "log").read_text() if (tmp_path / "log").exists() else "")
    assert "Traceback" not in shown
    assert done.returncode in (0, 1, 2), shown
    if where == "no directory" and done.returncode:
        assert "Error: " in shown


def test_what_an_interruption_becomes_within_a_lock_is_an_interruption(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        "import click, os, signal\n"
        "@click.command()\n"
        "def main():\n"
        "    try:\n"
        "        os.kill(os.getpid(), signal.SIGTERM)\n"
        "    except KeyboardInterrupt:\n"
        "        raise RuntimeError('release unlocked lock')\n"
    )
    program = "from glue.cli.entry import start; start('mine', 'main')"
    done = subprocess.run([sys.executable, "-c", program], cwd=tmp_path, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (143, "interrupted\n")
