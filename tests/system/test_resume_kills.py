"""SIGKILL at any moment, of any process: the run ends like an undisturbed one."""

from __future__ import annotations

import contextlib
import os
import random
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from experiment_runner.store.results import Results
from glue.errors import ExperimentError
from tests.proof import FULL, size
from tests.system.runs import SLOW_AGENT, children, contents, kill, metrics, start, wait_until

pytestmark = pytest.mark.stage("kills")

PLAYERS = ("--env", "mines", "--env-option", "random_start=true", "--agent", "slow.py:Slow")
PLANS = {
    "episodes": (*PLAYERS, "--episodes", size(300, 6_000), "--max-steps", 30, "--trials", 4, "--seed", 11),
    "steps and metrics": (
        *(*PLAYERS, "--steps", size(3_500, 70_000), "--metrics-every", 7),
        *("--max-steps", 30, "--trials", 4, "--seed", 12),
    ),
}
KILLS = size(4, 24)
VICTIMS = (
    "experiment",
    "player_command agent",
    "player_command environment",
    "experiment_runner.executors.workers",
)
LONGEST_LIFE = size(0.2, 1.0)


def wait_while_running(experiment: subprocess.Popen[str], true: Callable[[], object], what: str) -> None:
    """Return as soon as `true()`; fail if the experiment ends before."""

    def done() -> object:
        assert experiment.poll() is None, f"finished too early: {experiment.communicate()}"
        return true()

    wait_until(done, what)


def kill_one(experiment: subprocess.Popen[str], program: str, chance: random.Random) -> None:
    """Kill a process that runs a program, as soon as there is one; if these are players, all of them.

    On a busy machine one of the players may not have joined yet, and would not be missed.
    """

    def done() -> bool:
        running = children(experiment.pid, program)
        if not running:
            return False
        killed = 0
        for pid in running if "player_command" in program else [chance.choice(running)]:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
                killed += 1
        return killed > 0

    wait_while_running(experiment, done, program)


def wait_for_an_episode(experiment: subprocess.Popen[str], directory: Path) -> None:
    """Wait until one more episode is stored than now."""

    def stored() -> int:
        with contextlib.suppress(ExperimentError), Results.open(directory) as results:
            return sum(trial.done for trial in results.trials())
        return 0

    before = stored()
    wait_while_running(experiment, lambda: stored() > before, "an episode")


@pytest.mark.proof
@pytest.mark.parametrize("plan", PLANS)
def test_run_whose_processes_are_killed_ends_as_an_undisturbed_one(plan: str, tmp_path: Path) -> None:
    shutil.copy(SLOW_AGENT, tmp_path)
    slow = tmp_path / "slow"
    options = ("--agent-option", f"while_there={slow}", "--agent-option", "pause=0.3")
    undisturbed = start(*PLANS[plan], *options, "--in-process", "--out", "undisturbed", cwd=tmp_path)
    _, errors = undisturbed.communicate(timeout=size(200, 400))
    assert undisturbed.returncode == 0, errors
    if not FULL:  # without pauses, a short run may end before the last kill
        slow.touch()
    command = [*PLANS[plan], *options, "--workers", 2, "--checkpoint-every", 20, "--out", "killed"]
    chance = random.Random(4)
    experiment = start(*command, cwd=tmp_path)
    for number in range(KILLS):
        time.sleep(chance.uniform(0, LONGEST_LIFE))
        victim = VICTIMS[number % len(VICTIMS)]
        if not FULL or (number // len(VICTIMS)) % 2:  # in the middle of episodes, not at a start
            wait_for_an_episode(experiment, tmp_path / "killed")
        if victim == "experiment":
            kill(experiment)
            assert experiment.returncode == -signal.SIGKILL, "finished too early"
            experiment = start(*command, cwd=tmp_path)
        else:
            kill_one(experiment, victim, chance)
    slow.unlink(missing_ok=True)
    _, errors = experiment.communicate(timeout=size(200, 600))
    assert experiment.returncode == 0, errors
    assert contents(tmp_path / "killed") == contents(tmp_path / "undisturbed")
    assert metrics(tmp_path / "killed") == metrics(tmp_path / "undisturbed")
    assert bool(metrics(tmp_path / "killed")) == ("metrics" in plan)
    with Results.open(tmp_path / "killed") as results:
        events = {event.kind for event in results.events()}
        assert {"resume", "rewind", "lost"} <= events  # the experiment and workers were killed in the middle
        assert results.voids()  # and so were players
