"""Sending a run's results to a logger, during the run and after it.

Everything that is sent is already in the store, and a file in the run directory says how many episodes of
each trial the logger has: streaming continues from there, however it ended.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass
from importlib import import_module
from importlib.util import find_spec
from itertools import groupby
from pathlib import Path
from time import time
from typing import Final, NamedTuple, Protocol

import msgspec

from experiment_runner.loggers import LOGGERS
from experiment_runner.store.layout import STREAMS, RunLock, check_links, lock_holder, replace_flushed
from experiment_runner.store.records import EpisodeResult, known_measures
from experiment_runner.store.results import Results
from experiment_runner.store.run_data import Cell, settings_of
from glue.console import one_line
from glue.errors import ConfigError, ExperimentError, GlueError
from glue.files import read_regular
from glue.system import chance, clock


class Source(NamedTuple):
    """A trial, as loggers see it: each trial has its own run there.

    key       16 hexadecimal digits, unique among the trials of all runs
    run       name of the run directory
    trial     the trial's id
    settings  its seed, players and their options
    """

    key: str
    run: str
    trial: str
    settings: Mapping[str, Cell]

    @property
    def name(self) -> str:
        """Its display name, which contains the key: results in a directory may be replaced."""
        return f"{self.run}/{self.trial} {self.key[:6]}"


class Point(NamedTuple):
    """The values of a trial at one of its steps.

    episode  number of the episode, from 1
    step     steps of the trial until then
    time     seconds since 1970
    values   by name; they may be infinite or NaN
    """

    episode: int
    step: int
    time: float
    values: dict[str, float]


class Logger(Protocol):
    """Receives the points of trials."""

    def write(self, source: Source, points: Sequence[Point], finished: bool) -> bool:
        """Write points, each later than all before; return whether they would already survive a crash.

        If not, they do once `close` has returned. After a kill, points may be written a second time, which
        must not show.

        Args:
            source: their trial.
            points: one or more.
            finished: whether they are the trial's last.
        """
        ...

    def close(self) -> None:
        """Finish writing for now."""
        ...


def points_of(results: Results, trial_id: str, after: int, began: float) -> list[Point]:
    """Return the points of a trial's episodes after number `after`, in order.

    An episode's values are at its last step, those of the agent's metrics where they were read. Times are
    `began` plus the durations of the trial's episodes until then, so that every call gives the same ones.

    Args:
        results: of the run.
        trial_id: of the trial.
        after: number of an episode.
        began: seconds since 1970.
    """
    found: dict[int, Point] = {}
    times = [began]
    step = 0
    for episode in results.episodes(trial_id):
        step += episode.steps
        times.append(times[-1] + episode.wall_time)
        if episode.episode > after:
            found[step] = Point(episode.episode, step, times[-1], _values(episode))
    for name, metric in results.metrics(trial_id).items():
        for read_in, at, value in zip(*metric, strict=True):
            if after < (number := int(read_in)) < len(times):
                point = found.setdefault(int(at), Point(number, int(at), times[number], {}))
                point.values[f"agent/{name}"] = float(value)
    return [found[step] for step in sorted(found)]


def _values(episode: EpisodeResult) -> dict[str, float]:
    values = {**known_measures(episode), "number": episode.episode}
    return {f"episode/{name}": float(value) for name, value in values.items()}


_TOGETHER: Final = 500
"""Number of episodes written together; after a kill, as many may be written again."""

_POLL_SECONDS: Final = 2.0
_MOST_BYTES: Final = 2**26
_POSITIONS: Final = "positions.json"


@dataclass
class _Position:
    """The progress of sending a run to a project.

    Args:
        stream: distinguishes its trials from those of all other runs there.
        began: the time of each trial's beginning, as loggers show it, in seconds since 1970.
        episodes: the number of a trial's episodes that were sent, by id.
    """

    stream: str
    began: float
    episodes: dict[str, int]


def stream(directory: Path, name: str, project: str) -> int:
    """Send the results of a run to a logger, until no process writes to the run.

    Args:
        directory: of the run.
        name: of the logger.
        project: the logger's project that shows the trials. TensorBoard has none: its files are in the run.

    Returns:
        The number of episodes that were sent.

    Raises:
        ConfigError: the logger is not installed.
        ExperimentError: the run cannot be read, is being sent to this logger already, or the logger fails.
    """
    Results.open(directory).close()
    folder = directory / STREAMS / name
    check_links(directory)
    folder.mkdir(parents=True, exist_ok=True)
    lock = RunLock(folder)
    try:
        positions = _read(folder / _POSITIONS)
        position = positions.setdefault(project, _Position(chance.random_bytes(8).hex(), time(), {}))
        before = sum(position.episodes.values())
        sent = dict(position.episodes)

        def keep() -> None:
            replace_flushed(folder / _POSITIONS, json.dumps(positions, default=asdict))

        keep()  # otherwise another process would send the run again, as a different one
        with _open(name, folder if name == "tensorboard" else project) as logger:
            writing = True
            while writing:
                writing = lock_holder(directory) is not None
                with Results.open(directory) as results:
                    for trial_id in _send(results, logger, position, sent):
                        position.episodes[trial_id] = sent[trial_id]
                        keep()
                if writing:
                    clock.sleep(_POLL_SECONDS)
        position.episodes |= sent
        keep()
    finally:
        lock.release()
    return sum(sent.values()) - before


@contextmanager
def _open(name: str, where: object) -> Iterator[Logger]:
    """Yield a logger; its errors are reported under its name."""
    if find_spec(name) is None:
        raise ConfigError(f"{name} is not installed: pip install 'glue-rl[{name}]'")
    try:
        made = getattr(import_module(f"experiment_runner.loggers.{name}"), LOGGERS[name])
        with closing(made(where)) as logger:
            yield logger
    except GlueError:
        raise
    except Exception as error:
        raise ExperimentError(
            f"{name} did not take the results: {one_line(str(error)) or type(error).__name__}; "
            "nothing is lost: the same command continues from here"
        ) from error


def _send(results: Results, logger: Logger, position: _Position, sent: dict[str, int]) -> Iterator[str]:
    """Send the logger all new episodes; yield a trial's id whenever all that was sent of it is kept.

    Args:
        results: of the run.
        logger: the logger.
        position: the episodes that the logger has kept.
        sent: the episodes that the logger was sent, in the form of `position.episodes`.
    """
    joined = results.joined_players()
    for record in results.trials():
        spec, after = record.spec, sent.get(record.spec.id, 0)
        if record.done <= after:
            continue
        key = hashlib.sha256(f"{position.stream}/{spec.id}".encode()).hexdigest()[:16]
        source = Source(key, results.directory.absolute().name, spec.id, settings_of(spec, joined))
        # Without what was recorded meanwhile: nothing would be left with which to say that the trial is over.
        found = points_of(results, spec.id, after, position.began)
        points = [point for point in found if point.episode <= record.done]
        for _, part in groupby(points, lambda point: (point.episode - 1) // _TOGETHER):
            together = list(part)
            last = together[-1].episode
            kept = logger.write(source, together, record.finished and last == points[-1].episode)
            sent[spec.id] = last
            if kept:
                yield spec.id


def _read(path: Path) -> dict[str, _Position]:
    """Return the positions of a run by project; the file is not trusted, as a run may come from anyone.

    Raises:
        ExperimentError: the file is damaged.
    """
    if not path.exists():
        return {}
    try:
        return msgspec.json.decode(read_regular(path, _MOST_BYTES), type=dict[str, _Position])
    except (OSError, msgspec.DecodeError, RecursionError):
        raise ExperimentError(f"cannot read {path}: it is damaged; remove it to send all again") from None
