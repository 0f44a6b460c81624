"""A run that version 0.1.0 began and did not finish opens and continues as if it had never stopped.

tests/golden/run-0.1.0.tar.gz holds two runs of that version: `killed`, by SIGKILL in its second trial, before
the database's log was written back, and `undisturbed`, the same plan to its end. Both were made by

    glue-experiment --env mines --env-option random_start=true --agent sarsa --episodes 40 --max-steps 60 \\
        --trials 2 --seed 5 --checkpoint-every 10 --in-process --out DIRECTORY
"""

from __future__ import annotations

from pathlib import Path
from typing import Final

from tests.forked import run
from tests.system.runs import contents, unpack_older_runs

TRIALS: Final = ("sarsa/mines/0", "sarsa/mines/1")


def test_it_can_be_read_and_goes_on_from_its_checkpoint_to_the_same_end(tmp_path: Path) -> None:
    unpack_older_runs(tmp_path)
    killed, undisturbed = contents(tmp_path / "killed"), contents(tmp_path / "undisturbed")
    for trial, stored in zip(TRIALS, (40, 15), strict=True):
        assert killed[trial][0] == undisturbed[trial][0][:stored]
    resumed = run("glue-experiment", "--resume", "killed", "--in-process", cwd=tmp_path)
    assert resumed.returncode == 0, resumed.stderr
    assert "after episode 10" in resumed.stderr + resumed.stdout
    killed = contents(tmp_path / "killed")
    for trial in TRIALS:
        assert killed[trial][0] == undisturbed[trial][0]
    assert "glue-rl 0.1.0" in run("glue-results", "show", "killed", cwd=tmp_path).stdout
