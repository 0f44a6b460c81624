"""Trials as tasks of a job array, on a real SLURM of one node."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from experiment_runner.store.results import Results
from tests.pages import DOCS, blocks, run_block
from tests.system.runs import COMMAND, SLOW_AGENT, contents, run, wait_until
from tests.system.slurm.cluster import slurm_cluster
from tests.system.test_workers import FAULTY, MINES, SARSA

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", autouse=True)
def cluster() -> Iterator[Path]:
    with slurm_cluster() as folder:
        yield folder


def submit(*arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run `glue-experiment --engine slurm` in a fresh process, which sees this cluster's variable."""
    command = [*COMMAND, *map(str, arguments), "--engine", "slurm"]
    return subprocess.run(command, cwd=cwd, capture_output=True, text=True, timeout=60, check=False)


def queue() -> list[str]:
    """Return number, state and node of each job and task that is not over."""
    command = ["squeue", "--noheader", "--array", "--format=%A %i %T"]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout.splitlines()


def wait_until_over() -> None:
    wait_until(lambda: not queue(), "the end of all jobs")


def finished(directory: Path) -> bool:
    with Results.open(directory) as results:
        return all(trial.finished for trial in results.trials())


def log(directory: Path) -> str:
    return "\n".join(path.read_text() for path in sorted((directory / "parts").glob("*.log")))


def test_results_equal_those_of_workers_and_come_by_themselves(tmp_path: Path) -> None:
    plan = (*SARSA, "--episodes", 40, "--trials", 5, "--in-process")
    assert run(*plan, "--workers", 2, "--out", "workers", cwd=tmp_path).returncode == 0
    done = submit(*plan, "--out", "slurm", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    wait_until_over()
    assert contents(tmp_path / "slurm") == contents(tmp_path / "workers"), log(tmp_path / "slurm")
    with Results.open(tmp_path / "slurm") as results:
        assert "finish" in [event.kind for event in results.events()]
    assert not list((tmp_path / "slurm" / "parts").glob("*/"))

    again = submit(*plan, "--out", "slurm", cwd=tmp_path)
    assert again.returncode == 0
    assert "already finished" in again.stderr
    assert queue() == []


def test_missing_trials_run_after_a_task_was_killed(tmp_path: Path) -> None:
    (tmp_path / "faulty.py").write_text(FAULTY)
    plan = (*MINES, "--agent", "faulty.py:Faulty", "--episodes", 12, "--trials", 3, "--in-process")
    assert run(*plan, "--out", "undisturbed", cwd=tmp_path).returncode == 0
    options = ("--agent-option", "how=SIGKILL", "--agent-option", f"once={tmp_path}/mark")
    assert submit(*plan, *options, "--checkpoint-every", 4, "--out", "run", cwd=tmp_path).returncode == 0
    wait_until_over()
    assert not finished(tmp_path / "run")
    with Results.open(tmp_path / "run") as results:
        fewest, *others = sorted(trial.done for trial in results.trials())
    assert others == [12, 12]
    assert 4 <= fewest <= 6  # those after the checkpoint may not have been stored yet

    done = submit("--resume", "run", "--trust", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "1 trial in 1 task" in done.stderr
    wait_until_over()
    assert contents(tmp_path / "run") == contents(tmp_path / "undisturbed"), log(tmp_path / "run")


def test_preempted_tasks_leave_a_checkpoint_and_run_again(tmp_path: Path) -> None:
    shutil.copy(SLOW_AGENT, tmp_path)
    plan = (*MINES, "--agent", "slow.py:Slow", "--episodes", 2000, "--trials", 2, "--in-process")
    assert run(*plan, "--out", "undisturbed", cwd=tmp_path).returncode == 0
    (tmp_path / "slow").touch()
    slow = (*plan, "--agent-option", f"while_there={tmp_path}/slow", "--checkpoint-every", 0, "--out", "run")
    assert submit(*slow, "--sbatch", "partition=low", cwd=tmp_path).returncode == 0
    parts = [tmp_path / "run" / "parts" / number for number in "01"]
    wait_until(lambda: all(_done(part) >= 3 for part in parts), "three episodes of each")

    refused = submit(*slow, cwd=tmp_path)
    assert refused.returncode == 1
    assert "scancel" in refused.stderr
    local = run(*slow, cwd=tmp_path)
    assert local.returncode == 1
    assert "glue-results gather" in local.stderr

    urgent = ["sbatch", "--partition=high", "--ntasks=2", f"--output={tmp_path}/urgent", "--wrap=true"]
    subprocess.run(urgent, check=True, capture_output=True)
    wait_until((tmp_path / "urgent").exists, "the urgent job")
    begun = [_done(part) for part in parts]
    assert all(3 <= done < 2000 for done in begun)
    with Results.open(parts[0]) as results:  # the only checkpoint is that of a signal
        assert results.checkpointed() == {"Slow/mines/0": begun[0]}
    (tmp_path / "slow").unlink()
    for job in {line.split()[0] for line in queue()}:  # a requeued task waits for two minutes
        subprocess.run(["scontrol", "update", f"JobId={job}", "StartTime=now"], check=False)
    wait_until_over()
    assert contents(tmp_path / "run") == contents(tmp_path / "undisturbed"), log(tmp_path / "run")


def test_an_option_that_slurm_refuses_leaves_the_run_to_be_submitted_again(tmp_path: Path) -> None:
    plan = (*SARSA, "--episodes", 5, "--in-process", "--out", "run")
    refused = submit(*plan, "--sbatch", "partition=none", cwd=tmp_path)
    assert refused.returncode == 1
    assert "invalid partition" in refused.stderr
    assert "Traceback" not in refused.stderr
    assert submit(*plan, cwd=tmp_path).returncode == 0
    wait_until_over()
    assert finished(tmp_path / "run")


def test_text_can_be_followed(tmp_path: Path) -> None:
    for block in blocks((DOCS / "experiments.md").read_text("utf-8")):
        if block.file == "sweep.toml":
            (tmp_path / block.file).write_text(block.body.replace("episodes = 200", "episodes = 20"))
        elif "SLURM" in block.note:
            run_block(block, tmp_path)
            wait_until_over()
    assert finished(tmp_path / "runs" / "slurm"), log(tmp_path / "runs" / "slurm")


def _done(directory: Path) -> int:
    with Results.open(directory) as results:
        return sum(trial.done for trial in results.trials())
