"""Real runs of `glue-experiment`, for tests: starting them, watching their processes, comparing them."""

from __future__ import annotations

import subprocess
import sys
import tarfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from experiment_runner.store.records import Checkpoint
from experiment_runner.store.results import Results
from experiment_runner.store.run_data import metric_table
from tests import forked

COMMAND = [sys.executable, "-m", "glue_rl", "experiment"]
SLOW_AGENT = Path(__file__).parents[1] / "slow.py"
"""A module whose agent `Slow` keeps a run going until a test has done its part; a test copies it."""
_SECONDS = 200.0  # a search on a Ray cluster takes 40 on two quiet cores


def start(*arguments: object, cwd: Path) -> subprocess.Popen[str]:
    """Start `glue-experiment` in a session of its own, as a terminal would."""
    return subprocess.Popen(
        [*COMMAND, *map(str, arguments)],
        cwd=cwd,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def run(*arguments: object, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run `glue-experiment` to its end."""
    return forked.run("glue-experiment", *map(str, arguments), cwd=cwd, timeout=_SECONDS)


def unpack_older_runs(folder: Path) -> None:
    """Unpack the runs of version 0.1.0, also with Python 3.11.2, whose tar files have no filters."""
    with tarfile.open(Path(__file__).parents[1] / "golden/run-0.1.0.tar.gz") as runs:
        runs.extraction_filter = getattr(tarfile, "data_filter", None)
        runs.extractall(folder)


Contents = dict[str, tuple[list[tuple[int, float, int, bool]], tuple[int, Checkpoint] | None]]
"""Of each trial: every episode without its wall time, and the newest checkpoint."""


def contents(directory: Path) -> Contents:
    """Return the part of a run's results that must be the same for the same plan."""
    with Results.open(directory) as results:
        return {
            trial.spec.id: (
                [(e.episode, e.episode_return, e.steps, e.terminal) for e in results.episodes(trial.spec.id)],
                results.checkpoint(trial.spec.id),
            )
            for trial in results.trials()
        }


def metrics(directory: Path) -> list[list[list[str]]]:
    """Return the metric values of each trial that has any, which must be the same, too."""
    with Results.open(directory) as results:
        return [[[*map(str, row)] for row in rows] for rows in metric_table(results).rows]


def kill(command: subprocess.Popen[Any]) -> None:
    """Kill a command, and check that none of its processes outlives it."""
    processes = children(command.pid)
    command.kill()
    command.communicate()
    wait_until(lambda: not any(map(alive, processes)), "the end of its processes")


def children(pid: int, naming: str = "") -> list[int]:
    """Return the descendants of `pid` whose command line contains `naming`."""
    parents: dict[int, list[int]] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdigit() and (parent := _parent(int(entry.name))) is not None:
            parents.setdefault(parent, []).append(int(entry.name))
    found: list[int] = []
    new = [pid]
    while new:
        new = [child for one in new for child in parents.get(one, [])]
        found += new
    return sorted(child for child in found if naming in _command_line(child))


def alive(pid: int) -> bool:
    """Return whether a process exists and has not ended."""
    return _parent(pid) is not None


def _parent(pid: int) -> int | None:
    try:
        # The name of the program, in brackets, may hold anything.
        state, parent = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[:2]
    except OSError:
        return None
    return None if state in "ZX" else int(parent)


def _command_line(pid: int) -> str:
    try:
        return Path(f"/proc/{pid}/cmdline").read_bytes().replace(b"\0", b" ").decode()
    except OSError:
        return ""


def wait_until(true: Callable[[], object], what: str) -> None:
    """Return as soon as `true()`; fail after `_SECONDS`."""
    deadline = time.monotonic() + _SECONDS
    while not true():
        assert time.monotonic() < deadline, f"waited in vain for {what}"
        time.sleep(0.03)
