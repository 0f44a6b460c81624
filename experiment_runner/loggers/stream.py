"""Sending a run's results to a logger, during the run and after it.

Everything that is sent is already in the store, and a file in the run directory says how many episodes of
each trial the logger has: streaming continues from there, however it ended.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass, field
from importlib import import_module
from importlib.util import find_spec
from itertools import groupby
from pathlib import Path
from time import time
from typing import Final

from experiment_runner.loggers import LOGGERS
from experiment_runner.loggers.points import Logger, Source, points_of
from experiment_runner.store.export import settings_of
from experiment_runner.store.layout import STREAMS, check_links, replace_flushed
from experiment_runner.store.lock import RunLock, lock_holder
from experiment_runner.store.results import Results
from glue.console import one_line
from glue.errors import ConfigError, ExperimentError, GlueError
from glue.files import read_regular
from glue.system import chance, clock

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

    stream: str = field(default_factory=lambda: chance.random_bytes(8).hex())
    began: float = field(default_factory=time)
    episodes: dict[str, int] = field(default_factory=dict)


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
        position = positions.setdefault(project, _Position())
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
            "nothing is lost: the same command goes on from here"
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
        points = points_of(results, spec.id, after, position.began)
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
        text = read_regular(path, _MOST_BYTES)
        return {str(project): _position(fields) for project, fields in json.loads(text).items()}
    except (OSError, ValueError, TypeError, AttributeError, RecursionError):
        raise ExperimentError(f"cannot read {path}: it is damaged; remove it to send all again") from None


def _position(fields: object) -> _Position:
    match fields:
        case {"stream": str(stream), "began": float(began), "episodes": dict(episodes)}:
            return _Position(stream, began, {str(trial): int(number) for trial, number in episodes.items()})
    raise ValueError
