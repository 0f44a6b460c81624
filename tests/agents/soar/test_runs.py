"""Runs with agents on the Soar kernel: the kernel's process is killed, or a production fails."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
from pathlib import Path

import pytest

from experiment_runner.store.results import Results
from glue.errors import ExperimentError
from tests.system.runs import children, contents, run, start, wait_until

pytest.importorskip("soar_sml", reason="agents on the Soar kernel need it: pip install 'glue-rl[soar]'")

UP = Path(__file__).with_name("up.soar").read_text("utf-8")

PLAN = (
    *("--env", "mario", "--env-option", "max_trial_steps=100", "--agent", "soar-hierarchical"),
    *("--episodes", 25, "--checkpoint-every", 5, "--seed", 3, "--in-process"),
)
TRIAL = "soar-hierarchical/mario/0"


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("undisturbed")
    done = run(*PLAN, "--out", "run", cwd=folder)
    assert done.returncode == 0, done.stderr
    return folder / "run"


def after_a_checkpoint(experiment: subprocess.Popen[str], directory: Path) -> None:
    """Wait for a checkpoint, and for an episode after it."""

    def stored() -> bool:
        assert experiment.poll() is None, f"finished too early: {experiment.communicate()}"
        with contextlib.suppress(ExperimentError), Results.open(directory) as results:
            checkpoint = results.checkpoint(TRIAL)
            return checkpoint is not None and results.trials()[0].done > checkpoint[0]
        return False

    wait_until(stored, "an episode after a checkpoint")


def test_a_run_whose_process_is_killed_with_its_kernel_is_resumed(undisturbed: Path, tmp_path: Path) -> None:
    experiment = start(*PLAN, "--out", "run", cwd=tmp_path)
    after_a_checkpoint(experiment, tmp_path / "run")
    experiment.kill()
    experiment.communicate()
    assert experiment.returncode == -signal.SIGKILL
    # A saved agent breaks ties afresh, so checkpoints must fall on the same episodes.
    resumed = run("--resume", "run", "--in-process", "--checkpoint-every", 5, cwd=tmp_path)
    assert resumed.returncode == 0, resumed.stderr
    assert contents(tmp_path / "run") == contents(undisturbed)


def test_a_worker_that_is_killed_with_its_kernel_is_replaced(undisturbed: Path, tmp_path: Path) -> None:
    experiment = start(*PLAN, "--workers", 1, "--out", "run", cwd=tmp_path)
    after_a_checkpoint(experiment, tmp_path / "run")
    [worker] = children(experiment.pid, "experiment_runner.executors.workers")
    os.kill(worker, signal.SIGKILL)
    _, errors = experiment.communicate(timeout=60)
    assert experiment.returncode == 0, errors
    assert contents(tmp_path / "run") == contents(undisturbed)
    with Results.open(tmp_path / "run") as results:
        assert "lost" in {event.kind for event in results.events()}


def test_a_trial_whose_production_fails_is_recorded_with_the_reason_and_the_rest_go_on(
    tmp_path: Path,
) -> None:
    (tmp_path / "halting.soar").write_text(
        UP
        + """
sp {halt*in-the-third-episode
   (state <s> ^superstate nil ^io.input-link.step > 25)
-->
   (halt)
}
"""
    )
    (tmp_path / "plan.toml").write_text(
        """episodes = 5
[environments.skeleton]
[agents.bad]
class = "soar"
productions = "halting.soar"
[agents.good]
class = "random"
"""
    )
    done = run("--plan", "plan.toml", "--in-process", "--out", "run", cwd=tmp_path)
    assert done.returncode == 1, done.stderr
    assert "Traceback" not in done.stderr
    with Results.open(tmp_path / "run") as results:
        failures: dict[str, str | None] = {trial.spec.id: trial.failure for trial in results.trials()}
    assert failures["good/skeleton/0"] is None
    failure = failures["bad/skeleton/0"]
    assert failure is not None
    assert "halted in the middle of an episode" in failure
    assert "halted in the middle of an episode" in done.stderr
    kept = {name: len(episodes) for name, (episodes, _) in contents(tmp_path / "run").items()}
    assert kept == {"bad/skeleton/0": 2, "good/skeleton/0": 5}
