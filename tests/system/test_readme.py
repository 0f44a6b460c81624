"""README.md: its code runs, and so does every command in it, with two episodes where it says hundreds."""

from __future__ import annotations

import re
import shlex
from contextlib import ExitStack, closing
from pathlib import Path

import numpy as np
import pytest

from tests.forked import run
from tests.pages import ROOT, blocks, run_block
from tests.terminal import Terminal

BLOCKS = blocks((ROOT / "README.md").read_text(encoding="utf-8"))
PROGRAMS = [body for _, language, body in BLOCKS if language == "python" and "class " in body]
(SCRIPT,) = [block for block in BLOCKS if block.language == "python" and "class " not in block.body]
COMMANDS = [
    shlex.split(re.sub(r"--episodes \d+", "--episodes 2", line), comments=True)
    for _, language, body in BLOCKS
    if language == "sh"
    for line in body.splitlines()
    if line.startswith(("glue-experiment", "glue-env", "glue-agent"))
    and "sb3" not in line  # tests/glue/gym/test_sb3.py runs those
]
SCORES = [line for _, _, body in BLOCKS for line in body.splitlines() if line.startswith("glue-generalise")]
EXPERIMENT = ["glue-experiment", "--episodes", "2", "--max-steps", "50"]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A folder with the programs of the text, each in a file named like its class."""
    for program in PROGRAMS:
        (name,) = re.findall(r"^class (\w+)", program, re.M)
        (tmp_path / f"{name.lower()}.py").write_text(program, encoding="utf-8")
    return tmp_path


def partners(command: list[str], hub: str) -> list[list[str]]:
    """Return the commands of the other terminals; empty if the command itself runs all three roles."""
    environment, agent = ["glue-env", "mines", "--hub", hub], ["glue-agent", "random", "--hub", hub]
    match command[0]:
        case "glue-agent":
            return [[*EXPERIMENT, "--env", "mario", "--bind", hub]]
        case "glue-env":
            return [[*EXPERIMENT, "--agent", "random", "--bind", hub]]
        case _:
            missing = {"--env": environment, "--agent": agent}
            return [partner for option, partner in missing.items() if option not in command]


def test_text_has_commands_and_programs() -> None:
    assert {command[0] for command in COMMANDS} == {"glue-experiment", "glue-env", "glue-agent"}
    assert any(program.startswith("from glue import") for program in PROGRAMS)
    assert {block.language for block in BLOCKS} == {"sh", "python"}


@pytest.mark.parametrize("command", COMMANDS, ids=" ".join)
def test_command_runs(command: list[str], folder: Path) -> None:
    hub = f"ipc://{folder}/hub"
    others = partners(command, hub)
    address = {"glue-experiment": ["--bind", hub]}.get(command[0], ["--hub", hub]) if others else []
    with ExitStack() as stack:
        terminals = [stack.enter_context(closing(Terminal(*other, cwd=folder))) for other in others]
        shown = run(*command, *address, cwd=folder)
        assert shown.returncode == 0, shown.stderr
        assert [terminal.end() for terminal in terminals] == [0] * len(terminals)
        table = shown.stdout.splitlines() + [line for terminal in terminals for line in terminal.lines]
        assert any(re.search(r" 2/2 ", line) for line in table), table


def test_a_score_on_unseen_levels(tmp_path: Path) -> None:
    (line,) = SCORES
    shown = run(*shlex.split(line.replace("test-1000", "test-1000:2")), cwd=tmp_path)
    assert shown.returncode == 0, shown.stderr
    assert re.search(r"planner\b.*1\.000", shown.stdout), shown.stdout


def test_script_runs_an_experiment_and_reads_its_results(tmp_path: Path) -> None:
    (command,) = [command for command in COMMANDS if "runs/sarsa" in command]
    assert run(*command, cwd=tmp_path).returncode == 0
    *episodes, mean = run_block(SCRIPT, tmp_path).stdout.splitlines()
    assert len(episodes) == 100
    assert np.isfinite(float(mean))
