"""MLflow: a run for each trial, at the tracking server or in the files that MLFLOW_TRACKING_URI names."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Final

from mlflow import MlflowClient
from mlflow.entities import Metric, Param

from experiment_runner.loggers.stream import Logger, Point, Source

_TAG: Final = "glue.trial"
_MOST_METRICS: Final = 1000
_MOST_PARAMS: Final = 100
"""Maximum number in one request."""


class MLflow(Logger):
    """Writes to an experiment of MLflow. A value that is written twice is kept once, as its time is the same.

    Args:
        project: name of the experiment.
    """

    def __init__(self, project: str) -> None:
        self._client = MlflowClient()
        found = self._client.get_experiment_by_name(project)
        self._experiment: str = (
            self._client.create_experiment(project) if found is None else found.experiment_id
        )
        self._runs: dict[str, str] = {}

    def write(self, source: Source, points: Sequence[Point], finished: bool) -> bool:
        """Write to the trial's run."""
        run = self._runs.get(source.key)
        if run is None:
            run = self._runs[source.key] = self._open(source)
        metrics = [
            Metric(_accepted(name), value, int(point.time * 1000), point.step)
            for point in points
            for name, value in point.values.items()
        ]
        for first in range(0, len(metrics), _MOST_METRICS):
            self._client.log_batch(run, metrics[first : first + _MOST_METRICS])
        if finished:
            self._client.set_terminated(self._runs.pop(source.key))
        return True

    def _open(self, source: Source) -> str:
        """Return the id of the trial's run, which is created if it does not exist."""
        found = self._client.search_runs([self._experiment], f"tags.`{_TAG}` = '{source.key}'")
        if found:
            return str(found[0].info.run_id)
        made = self._client.create_run(self._experiment, tags={_TAG: source.key}, run_name=source.name)
        params = [Param(_accepted(name), str(value)) for name, value in source.settings.items()]
        for first in range(0, len(params), _MOST_PARAMS):
            self._client.log_batch(made.info.run_id, params=params[first : first + _MOST_PARAMS])
        return str(made.info.run_id)


def _accepted(name: str) -> str:
    """Return a name with `_` in place of what MLflow refuses in one: it may become the path of a file."""
    parts = re.sub(r"[^\w/. :-]", "_", name).split("/")
    return "/".join("_" if part in ("", ".", "..") else part for part in parts)
