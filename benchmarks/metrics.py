"""The cost of recording an agent's metrics, in one process: where episodes are shortest, and in Mario."""

from __future__ import annotations

import io
import shutil
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

from benchmarks.measure import Table, count, interleaved
from experiment_runner.executors.run import RunConfig, run_trials
from experiment_runner.meeting.players import BOTH, Meeting
from experiment_runner.plan.metrics import MetricsPlan
from experiment_runner.plan.plan import Plan, RoleSweep
from experiment_runner.report.progress import Progress
from experiment_runner.store.store import Store

_REPEATS: Final = 15


class _Task(NamedTuple):
    environment: str
    agent: str
    learned: int
    """Episodes before those that are measured."""
    measured: int

    def plan(self, episodes: int) -> Plan:
        """Return a plan of so many episodes."""
        players = (RoleSweep(self.environment),), (RoleSweep(self.agent),)
        return Plan(episodes=episodes, max_steps=500, environments=players[0], agents=players[1])


_TASKS: Final = (_Task("mines", "sarsa", 3000, 1000), _Task("mario", "hierarchical", 300, 300))
_KINDS: Final = {
    "no metrics": None,
    "after each episode": MetricsPlan(),
    "every 1,000 steps": MetricsPlan(1000),
    "every 100 steps": MetricsPlan(100),
}


def run() -> list[Table]:
    """Measure the CPU time of episodes with metrics and without, all commits included."""
    rows = [row for task in _TASKS for row in _rows(task)]
    tasks = "; ".join(
        f"`--env {task.environment} --agent {task.agent}`, {task.measured:,} episodes after the first "
        f"{task.learned:,}"
        for task in _TASKS
    )
    return [
        Table(
            "Metrics",
            f"`glue-experiment --in-process`, results and metrics committed to disk: {tasks}. The CPU time "
            f"of an episode is the median of {_REPEATS} runs of each kind, and the last column the median of "
            "the ratios within each turn (the aim is at most 3 %). Episodes in the mines are the shortest.",
            ("environment", "readings", "CPU time of an episode", "more than without"),
            rows,
        )
    ]


def _rows(task: _Task) -> Iterator[tuple[str, str, str, str]]:
    with tempfile.TemporaryDirectory() as folder:
        learned = Path(folder, "learned")
        with Store.create(learned, task.plan(task.learned).expand(), {}) as store:
            run_trials(store, RunConfig(Meeting(inside=BOTH)), Progress(io.StringIO()))
        measures: list[Callable[[], float]] = [
            partial(_seconds, task, learned, Path(folder, "run"), metrics) for metrics in _KINDS.values()
        ]
        found = interleaved(measures, _REPEATS)
    for kind, seconds in zip(_KINDS, found, strict=True):
        more = statistics.median(ours / bare - 1 for ours, bare in zip(seconds, found[0], strict=True))
        each = statistics.median(seconds) / task.measured * 1e6
        yield task.environment, kind, f"{count(each)} µs", f"{100 * more:.1f} %"


def _seconds(task: _Task, learned: Path, directory: Path, metrics: MetricsPlan | None) -> float:
    """Return the CPU time of the episodes after those that were learned from."""
    shutil.copytree(learned, directory)
    with Store.open(directory) as store:
        store.extend(task.plan(task.learned + task.measured).expand())
        began = time.process_time()
        run_trials(store, RunConfig(Meeting(inside=BOTH), metrics=metrics), Progress(io.StringIO()))
        took = time.process_time() - began
    shutil.rmtree(directory)
    return took
