"""Verifying a competition: recorded steps replayed per second, and the size of a record."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.measure import Table, count, medians
from experiment_runner.competition.records.replay import replay_of
from experiment_runner.competition.records.verify import replay_trial
from experiment_runner.executors.recording import run_of
from experiment_runner.plan.limits import TrialId
from experiment_runner.plan.plan import RoleSpec, TrialSpec
from glue.trajectory import ActionWriter, Ending
from glue.types import Action

_STEPS = 200_000
_LEVEL_SEED = 3
_LEGAL = [Action(ints=[d, j, r]) for d in (-1, 0, 1) for j in (0, 1) for r in (0, 1)]
_RUN = [_LEGAL.index(Action(ints=[1, int(i % 7 < 4), 1])) for i in range(7)]


def run() -> list[Table]:
    """Measure how fast records of Infinite Mario are verified."""
    spec = TrialSpec(
        TrialId("a/mario/0"), RoleSpec("a"), RoleSpec("mario", {"level_seed": _LEVEL_SEED}), 1, 0, 0
    )
    rng = np.random.default_rng(1)
    policies: dict[str, Callable[[int], np.ndarray]] = {
        "runs right and reaches the goal": lambda n: np.resize(_RUN, n),
        "acts at random": lambda n: rng.integers(0, len(_LEGAL), n),
    }
    with tempfile.TemporaryDirectory() as folder:
        paths = {name: _record(spec, Path(folder, name), act) for name, act in policies.items()}
        rates = medians([_replaying(spec, path) for path in paths.values()])
        sizes = [path.stat().st_size / _STEPS for path in paths.values()]
    return [
        Table(
            "Verifying a competition",
            "Recorded steps of Infinite Mario that `glue-compete verify` plays again, per second of one "
            "core's time (the aim is 200,000), and bytes of the record per step (the aim is 4).",
            ("the agent", "steps per second", "bytes per step"),
            [
                (name, count(rate), f"{size:.2f}")
                for name, rate, size in zip(policies, rates, sizes, strict=True)
            ],
        )
    ]


def _record(spec: TrialSpec, path: Path, act: Callable[[int], np.ndarray]) -> Path:
    """Play `_STEPS` steps, and record them as a competition does."""
    replay, task_spec = replay_of(spec)
    pieces: list[bytes] = []
    writer = ActionWriter(pieces.append)
    writer.run(run_of(spec, task_spec))
    left = _STEPS
    while left:
        replay.start()
        writer.start()
        choices = act(min(left, 2000))
        rewards, ended = replay.play(_LEGAL, choices)
        for choice, reward in zip(choices.tolist(), rewards.tolist(), strict=False):
            writer.step(_LEGAL[choice].body, reward)
        writer.end(Ending.TERMINAL if ended else Ending.CUTOFF)
        left -= len(rewards)
    writer.close()
    path.write_bytes(b"".join(pieces))
    return path


def _replaying(spec: TrialSpec, path: Path) -> Callable[[], float]:
    def measure() -> float:
        began = time.process_time()  # CPU time, regardless of other work
        replay_trial(spec, path)
        return _STEPS / (time.process_time() - began)

    return measure
