"""TensorBoard: event files, as SummaryWriter of PyTorch or TensorFlow writes them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from tensorboard.compat.proto.event_pb2 import Event, SessionLog
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.plugins.hparams.metadata import NULL_TENSOR, SESSION_START_INFO_TAG, create_summary_metadata
from tensorboard.plugins.hparams.plugin_data_pb2 import HParamsPluginData
from tensorboard.summary.writer.event_file_writer import EventFileWriter

from experiment_runner.loggers.stream import Point, Source
from experiment_runner.store.run_data import Cell
from glue.errors import ExperimentError

_SECONDS: Final = 1e9
"""Interval in seconds at which the writer flushes on its own: in effect never."""


class TensorBoard:
    """Writes to a folder for each trial.

    Args:
        folder: holds these folders.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._writers: dict[str, EventFileWriter] = {}

    def write(self, source: Source, points: Sequence[Point], finished: bool) -> bool:
        """Write to the trial's file, and flush it."""
        writer = self._writers.get(source.key)
        if writer is None:
            writer = self._writers[source.key] = self._open(source, points[0])
        for point in points:
            scalars = [Summary.Value(tag=name, simple_value=value) for name, value in point.values.items()]
            writer.add_event(Event(step=point.step, wall_time=point.time, summary=Summary(value=scalars)))
        writer.flush()
        if finished:
            self._writers.pop(source.key).close()
        return True

    def close(self) -> None:
        """Close all files."""
        for writer in self._writers.values():
            writer.close()
        self._writers.clear()

    def _open(self, source: Source, first: Point) -> EventFileWriter:
        folder = self._folder / source.trial
        if not folder.resolve().is_relative_to(self._folder.resolve()):
            raise ExperimentError(f"the id of trial {source.trial} would lead out of {self._folder}")
        writer = EventFileWriter(str(folder), flush_secs=_SECONDS)
        # From this step on, TensorBoard drops the points of an earlier file, left by a killed process.
        start = SessionLog(status=SessionLog.START)
        writer.add_event(Event(step=first.step, wall_time=first.time, session_log=start))
        writer.add_event(Event(wall_time=first.time, summary=_hparams(source.settings)))
        return writer


def _hparams(settings: Mapping[str, Cell]) -> Summary:
    """Return a trial's summary for the tab HPARAMS."""
    data = HParamsPluginData()
    for name, value in settings.items():
        entry = data.session_start_info.hparams[name]
        if isinstance(value, bool):
            entry.bool_value = value
        elif isinstance(value, (int, float)):
            entry.number_value = value
        else:
            entry.string_value = str(value)
    shown = Summary.Value(
        tag=SESSION_START_INFO_TAG, metadata=create_summary_metadata(data), tensor=NULL_TENSOR
    )
    return Summary(value=[shown])
