"""Weights & Biases: a run for each trial, sent at once or, with WANDB_MODE=offline, kept for `wandb sync`."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import wandb

from experiment_runner.loggers.stream import Point, Source


class WeightsAndBiases:
    """Writes to a project. The server ignores a point that is written twice, as its step is the same.

    Args:
        project: its name.
    """

    def __init__(self, project: str) -> None:
        self._project = project
        self._runs: dict[str, Any] = {}

    def write(self, source: Source, points: Sequence[Point], finished: bool) -> bool:
        """Hand the points to W&B's own process; they are safe only once the run is finished."""
        run = self._runs.get(source.key)
        if run is None:
            run = self._runs[source.key] = wandb.init(
                project=self._project,
                id=source.key,
                name=source.name,
                group=source.run,
                config=dict(source.settings),
                resume="allow",
                reinit="create_new",
                settings=wandb.Settings(console="off", quiet=True, x_disable_stats=True),
            )
        for point in points:
            run.log(point.values, step=point.step)
        if finished:
            self._runs.pop(source.key).finish()
        return finished

    def close(self) -> None:
        """Send the rest, and end all runs."""
        for run in self._runs.values():
            run.finish()
        self._runs.clear()
