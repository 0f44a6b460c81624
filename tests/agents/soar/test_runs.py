"""A run with an agent on the Soar kernel, whose process is killed."""

from __future__ import annotations

import contextlib
import signal
from pathlib import Path

import pytest

from experiment_runner.store.results import Results
from glue.errors import ExperimentError
from tests.system.runs import contents, run, start, wait_until

pytest.importorskip("soar_sml", reason="agents on the Soar kernel need it: pip install 'glue-rl[soar]'")

PLAN = (
    *("--env", "mario", "--env-option", "max_trial_steps=100", "--agent", "soar-hierarchical"),
    *("--episodes", 25, "--checkpoint-every", 5, "--seed", 3, "--in-process"),
)


def test_a_run_whose_process_is_killed_with_its_kernel_is_resumed(tmp_path: Path) -> None:
    experiment = start(*PLAN, "--out", "run", cwd=tmp_path)

    def an_episode_after_a_checkpoint() -> bool:
        assert experiment.poll() is None, f"finished too early: {experiment.communicate()}"
        with contextlib.suppress(ExperimentError), Results.open(tmp_path / "run") as results:
            checkpoint = results.checkpoint("soar-hierarchical/mario/0")
            return checkpoint is not None and results.trials()[0].done > checkpoint[0]
        return False

    wait_until(an_episode_after_a_checkpoint, "an episode after a checkpoint")
    experiment.kill()
    experiment.communicate()
    assert experiment.returncode == -signal.SIGKILL
    # A saved agent breaks ties afresh, so checkpoints must fall on the same episodes.
    resumed = run("--resume", "run", "--in-process", "--checkpoint-every", 5, cwd=tmp_path)
    assert resumed.returncode == 0, resumed.stderr
    assert run(*PLAN, "--out", "undisturbed", cwd=tmp_path).returncode == 0
    assert contents(tmp_path / "run") == contents(tmp_path / "undisturbed")
