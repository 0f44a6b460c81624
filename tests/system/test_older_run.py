"""A run that version 0.1.0 began and did not finish opens and continues as if it had never stopped.

tests/golden/run-0.1.0.tar.gz holds two runs of that version: `killed`, by SIGKILL in its second trial, before
the database's log was written back, and `undisturbed`, the same plan to its end. Both were made by

    glue-experiment --env mines --env-option random_start=true --agent sarsa --episodes 40 --max-steps 60 \\
        --trials 2 --seed 5 --checkpoint-every 10 --in-process --out DIRECTORY
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

import pytest

from tests.forked import run
from tests.system.runs import contents, unpack_older_runs

TRIALS: Final = ("sarsa/mines/0", "sarsa/mines/1")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    unpack_older_runs(tmp_path)
    return tmp_path


def test_its_episodes_can_be_read(folder: Path) -> None:
    killed, undisturbed = contents(folder / "killed"), contents(folder / "undisturbed")
    for trial, stored in zip(TRIALS, (40, 15), strict=True):
        assert killed[trial][0] == undisturbed[trial][0][:stored]
    shown = run("glue-results", "show", "killed", cwd=folder)
    assert shown.returncode == 0, shown.stderr
    assert "glue-rl 0.1.0" in shown.stdout


def test_it_goes_on_from_its_checkpoint_to_the_same_end(folder: Path) -> None:
    resumed = run("glue-experiment", "--resume", "killed", "--in-process", cwd=folder)
    assert resumed.returncode == 0, resumed.stderr
    assert "after episode 10" in resumed.stderr + resumed.stdout
    killed, undisturbed = contents(folder / "killed"), contents(folder / "undisturbed")
    for trial in TRIALS:
        assert killed[trial][0] == undisturbed[trial][0]
