"""The cost of recording an agent's metrics, where episodes are shortest: the mines, in one process."""

from __future__ import annotations

import io
import shutil
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Final

from benchmarks.measure import Table, count, interleaved
from experiment_runner.executors.job import BOTH, Placement, RunConfig
from experiment_runner.executors.run import run_trials
from experiment_runner.plan.metrics import MetricsPlan
from experiment_runner.plan.plan import Plan, RoleSweep
from experiment_runner.report.progress import Progress
from experiment_runner.store.store import Store

_LEARNED: Final = 3000  # episodes, after which they are short
_MEASURED: Final = 500
_REPEATS: Final = 61
_PLAN: Final = Plan(
    episodes=_LEARNED,
    max_steps=500,
    environments=(RoleSweep("mines"),),
    agents=(RoleSweep("sarsa"),),
)
_KINDS: Final = {
    "no metrics": None,
    "after each episode": MetricsPlan(),
    "every 1,000 steps": MetricsPlan(1000),
    "every 100 steps": MetricsPlan(100),
}


def run() -> list[Table]:
    """Measure the CPU time of episodes with metrics and without, all commits included."""
    with tempfile.TemporaryDirectory() as folder:
        learned = Path(folder, "learned")
        with Store.create(learned, _PLAN.expand(), {}) as store:
            run_trials(store, RunConfig(Placement(inside=BOTH)), Progress(io.StringIO()))
        measures: list[Callable[[], float]] = [
            partial(_seconds, learned, Path(folder, "run"), metrics) for metrics in _KINDS.values()
        ]
        found = interleaved(measures, _REPEATS)
    rows = []
    for kind, seconds in zip(_KINDS, found, strict=True):
        more = statistics.median(ours / bare - 1 for ours, bare in zip(seconds, found[0], strict=True))
        each = statistics.median(seconds) / _MEASURED * 1e6
        rows.append((kind, f"{count(each)} µs", f"{100 * more:.1f} %"))
    return [
        Table(
            "Metrics",
            f"`glue-experiment --env mines --agent sarsa --in-process`: {_MEASURED:,} episodes after the "
            f"first {_LEARNED:,}, whose results and four metrics are committed to disk. The CPU time of an "
            f"episode is the median of {_REPEATS} runs of each kind, and the last column the median of the "
            "ratios within each turn (the aim is at most 3 %).",
            ("readings", "CPU time of an episode", "more than without"),
            rows,
        )
    ]


def _seconds(learned: Path, directory: Path, metrics: MetricsPlan | None) -> float:
    """Return the CPU time of the episodes after the learning episodes."""
    shutil.copytree(learned, directory)
    with Store.open(directory) as store:
        store.extend(replace(_PLAN, episodes=_LEARNED + _MEASURED).expand())
        began = time.process_time()
        run_trials(store, RunConfig(Placement(inside=BOTH), metrics=metrics), Progress(io.StringIO()))
        took = time.process_time() - began
    shutil.rmtree(directory)
    return took
