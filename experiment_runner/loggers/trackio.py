"""Trackio: a run for each trial, in a project on this machine or, with TRACKIO_SERVER_URL, on a server."""

from __future__ import annotations

import io
import warnings
from collections.abc import Sequence
from contextlib import redirect_stdout

import trackio
from trackio.sqlite_storage import SQLiteStorage

from experiment_runner.loggers.stream import Logger, Point, Source
from glue.errors import ExperimentError


class Trackio(Logger):
    """Writes to a project.

    Args:
        project: its name.
    """

    def __init__(self, project: str) -> None:
        self._project = project

    def write(self, source: Source, points: Sequence[Point], finished: bool) -> bool:
        """Write to the trial's run, which is opened and finished each time: only finishing flushes it.

        Raises:
            ExperimentError: Trackio has lost points; its writing threads warn about that.
        """
        with redirect_stdout(io.StringIO()), warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("ignore")
            warnings.simplefilter("always", UserWarning)
            last = SQLiteStorage.get_last_step(self._project, source.name)
            run = trackio.init(
                project=self._project,
                name=source.name,
                group=source.run,
                config=dict(source.settings),
                resume="allow",
                embed=False,
                auto_log_cpu=False,
                auto_log_gpu=False,
            )
            for point in points:
                if last is None or point.step > last:
                    run.log(point.values, step=point.step)
            trackio.finish()
        if warned:
            raise ExperimentError(f"Trackio warns: {warned[0].message}")
        return True
