"""docs/experiments.md and the tutorials: all commands run, in order, with 20 episodes instead of hundreds."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from experiment_runner.plan.file import load_plan
from experiment_runner.store.results import Results
from tests.shell import bash
from tests.system.runs import contents

ROOT = Path(__file__).parents[2]
TEXT = (ROOT / "docs" / "experiments.md").read_text(encoding="utf-8")
BLOCK = re.compile(r"^<!-- (?P<note>.*?) -->\n```(?P<language>\w+)\n(?P<body>.*?)^```$", re.M | re.S)
SECONDS = 120
HUNDREDS = re.compile(r"(?<=episodes )[12]00\b|(?<=episodes = )[12]00\b")

SHELL = "runs in the tests"
PYTHON = "runs in the tests, with Python"


def test_every_block_is_accounted_for() -> None:
    assert TEXT.count("```") == 2 * len(BLOCK.findall(TEXT))
    notes = {note for note, _, _ in BLOCK.findall(TEXT)}
    assert notes == {
        SHELL,
        PYTHON,
        *(f"runs in the tests, where {what} installed" for what in ("Ray is", "SLURM is", "loggers are")),
        "file: lazy.py",
        "file: metrics.toml",
        "file: sweep.toml",
        "file: tune.toml",
    }


def follow(folder: Path, text: str = TEXT) -> None:
    """Write every file of a text, and run every command."""
    for block in BLOCK.finditer(text):
        note, body = block["note"], HUNDREDS.sub("20", block["body"])
        if note.startswith("file: "):
            (folder / note.removeprefix("file: ")).write_text(body)
        elif note == SHELL:
            done = bash(body, folder, SECONDS)
            assert done.returncode == 0, f"{body}\n{done.stdout}\n{done.stderr}"
        elif note == PYTHON:
            subprocess.run([sys.executable, "-c", body], cwd=folder, check=True, timeout=SECONDS)


@pytest.mark.slow
def test_first_agent_can_be_followed(tmp_path: Path) -> None:
    text = (ROOT / "docs" / "first-agent.md").read_text(encoding="utf-8")
    assert text.count("```") == 2 * len(BLOCK.findall(text))
    follow(tmp_path, text)
    assert (tmp_path / "first.png").stat().st_size > 0
    with Results.open(tmp_path / "runs" / "first") as results:
        assert all(trial.finished for trial in results.trials())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("page", "made"),
    [("first-experiment", "compare.png"), ("first-competition", "board.html"), ("notebooks", "")],
)
def test_tutorial_can_be_followed(page: str, made: str, tmp_path: Path) -> None:
    text = (ROOT / "docs" / f"{page}.md").read_text(encoding="utf-8")
    follow(tmp_path, text.replace("episodes = 5\n", "episodes = 1\n"))  # of the competition's Mario
    assert (tmp_path / made).stat().st_size > 0


@pytest.mark.slow
def test_text_can_be_followed(tmp_path: Path) -> None:
    follow(tmp_path)
    for name in ("first.csv", "first.png", "sweep.png", "sweep.svg", "sweep.parquet"):
        assert (tmp_path / name).stat().st_size > 0, name
    for run in ("first", "trials", "try", "sweep", "killed", "both"):
        with Results.open(tmp_path / "runs" / run) as results:
            assert all(trial.finished for trial in results.trials()), run
    # The run continues after the kill; had it ended before, the text would show nothing.
    with Results.open(tmp_path / "runs" / "killed") as results:
        assert [event.kind for event in results.events()][:2] == ["start", "resume"]
    assert "sarsa/mines/3" in contents(tmp_path / "runs" / "trials")
    assert (
        len(load_plan(tmp_path / "sweep.toml").expand()) == len(contents(tmp_path / "runs" / "sweep")) == 12
    )
