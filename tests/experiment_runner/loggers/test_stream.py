"""Results in the programs that show them: complete and without duplicates, even if streaming was killed."""

from __future__ import annotations

import json
import random
import signal
import subprocess
import sys
import time
from collections import defaultdict
from pathlib import Path

import pytest

from tests.experiment_runner.loggers.programs import PROGRAMS, PROJECT, Shown, prepare, settings
from tests.forked import BIN
from tests.pages import DOCS, blocks, run_block
from tests.proof import size
from tests.system.runs import start

pytestmark = pytest.mark.slow


@pytest.fixture(params=PROGRAMS)
def program(request: pytest.FixtureRequest) -> str:
    """The name of a program that is installed."""
    pytest.importorskip(request.param)
    return str(request.param)


def streaming(program: str, run: Path) -> subprocess.Popen[bytes]:
    words = ["stream", str(run), "--to", program, "--project", PROJECT]
    command = [sys.executable, str(BIN / "glue-results"), *words]
    return subprocess.Popen(command, cwd=run.parent, env=settings(run.parent), stderr=subprocess.PIPE)


def exported(run: Path, *options: str) -> list[dict[str, float | str]]:
    command = [str(BIN / "glue-results"), "export", str(run), "--format", "json", *options]
    rows: list[dict[str, float | str]] = json.loads(subprocess.check_output(command))
    return rows


def expected(run: Path) -> Shown:
    """Return a run as in its own tables."""
    shown: defaultdict[str, defaultdict[str, list[tuple[int, float]]]]
    shown = defaultdict(lambda: defaultdict(list))
    steps: defaultdict[str, int] = defaultdict(int)
    for row in exported(run):
        trial = str(row["trial"])
        steps[trial] += int(row["steps"])
        for name in ("return", "steps", "terminal", "wall_time"):
            shown[trial][f"episode/{name}"].append((steps[trial], float(row[name])))
        shown[trial]["episode/number"].append((steps[trial], float(row["episode"])))
    for row in exported(run, "--metrics"):
        value = (int(row["step"]), float(row["value"]))
        shown[str(row["trial"])][f"agent/{row['metric']}"].append(value)
    return {trial: dict(metrics) for trial, metrics in shown.items()}


def check(program: str, run: Path) -> None:
    """Check that a program has all of a run exactly once."""
    found, wanted = PROGRAMS[program](run.parent, run), expected(run)
    assert found.keys() == wanted.keys()
    for trial, metrics in wanted.items():
        assert found[trial].keys() == metrics.keys()
        for name, values in metrics.items():
            steps = [step for step, _ in found[trial][name]]
            assert steps == [step for step, _ in values], (trial, name)
            # TensorBoard stores numbers in single precision.
            assert [value for _, value in found[trial][name]] == pytest.approx(
                [value for _, value in values], rel=1e-6
            )


def test_finished_run_is_sent_once(program: str, tmp_path: Path) -> None:
    run = tmp_path / "mine"
    options = ("--env", "mines", "--agent", "sarsa", "--episodes", 700, "--trials", 2, "--seed", 1)
    with start(*options, "--in-process", "--out", run, cwd=tmp_path) as running:
        running.communicate(timeout=120)
    for sent in (1400, 0):
        with streaming(program, run) as process:
            _, said = process.communicate(timeout=120)
        assert process.returncode == 0, said
        assert f"sent {sent:,} episodes of {run} to {program}" in said.decode().replace("1400", "1,400")
    check(program, run)


@pytest.mark.proof
def test_run_in_progress_is_sent_however_often_the_streaming_is_killed(program: str, tmp_path: Path) -> None:
    run, chance = tmp_path / "mine", random.Random(program)
    prepare(program, tmp_path)
    plan = ("--env", "mario", "--agent", "hierarchical", "--trials", 2, "--seed", 1)
    episodes = ("--episodes", size(700, 1500))
    with start(*plan, *episodes, "--in-process", "--out", run, cwd=tmp_path) as running:
        while not (run / "results.sqlite").exists():
            assert running.poll() is None
        while running.poll() is None:
            process = streaming(program, run)
            time.sleep(chance.uniform(1, 5))
            process.send_signal(signal.SIGKILL)
            process.communicate()
        running.communicate()
    with streaming(program, run) as process:
        _, said = process.communicate(timeout=240)
    assert process.returncode == 0, said
    check(program, run)


def test_text_can_be_followed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in PROGRAMS:
        pytest.importorskip(name)
    with start(
        "--env", "mines", "--agent", "sarsa", "--episodes", 20, "--out", "runs/first", cwd=tmp_path
    ) as run:
        run.communicate(timeout=60)
    monkeypatch.setenv("TRACKIO_DIR", str(tmp_path / "trackio"))
    page = (DOCS / "experiments.md").read_text("utf-8")
    (block,) = (block for block in blocks(page) if "loggers" in block.note)
    done = run_block(block, tmp_path)
    assert done.stderr.count("sent 20 episodes of runs/first") == 4
    assert done.stdout == ""
