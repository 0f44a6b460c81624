"""The points that a logger receives: values of a trial at its steps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

from experiment_runner.store.export import Cell
from experiment_runner.store.records import MEASURES, EpisodeResult
from experiment_runner.store.results import Results


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
    measures = dict(zip(MEASURES, episode[1:], strict=True))
    return {f"episode/{name}": float(value) for name, value in measures.items()} | {
        "episode/number": float(episode.episode)
    }
