"""The readings of agents' metrics as rows of the database: one row for all that are committed together.

The data of a row is a matrix of doubles, little-endian, with a row for each reading: its episode, its step,
then the value of each name. Storing each value, or each reading, as a row of its own takes several times as
long, which is noticeable when an episode takes a fifth of a millisecond.
"""

from __future__ import annotations

import itertools
import sqlite3
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple

import numpy as np
import numpy.typing as npt

from experiment_runner.store.records import Reading
from glue.errors import ExperimentError

_MOST_STEPS: Final = 2.0**53


class Metric(NamedTuple):
    """The values of a metric of a trial: three arrays of shape (values,).

    episodes  the episode in which each was read
    steps     steps of the trial until then
    values    may be infinite or NaN
    """

    episodes: npt.NDArray[np.float64]
    steps: npt.NDArray[np.float64]
    values: npt.NDArray[np.float64]


class Part(NamedTuple):
    """The values of a metric that are still too few to be averaged: the number of their group, in the order
    of the trial, their sum, and their count.
    """

    group: int
    total: float
    members: int


NO_METRIC: Final = Metric(np.empty(0), np.empty(0), np.empty(0))


class Block:
    """The readings of episodes of a trial that are committed together, by the names of their values.

    Attributes:
        episode: the last of the episodes.
    """

    def __init__(self) -> None:
        self.episode: int = 0
        self._numbers: dict[tuple[str, ...], list[float]] = defaultdict(list)

    def add(self, episode: int, readings: Iterable[Reading]) -> None:
        """Add the readings of the next episode."""
        self.episode = episode
        for step, values in readings:
            self._numbers[tuple(values)].extend((episode, step, *values.values()))

    def data(self) -> dict[str, bytes]:
        """Return the data by the names, one on each line."""
        return {"\n".join(names): np.array(row, "<f8").tobytes() for names, row in self._numbers.items()}


def unpacked(rows: Iterable[tuple[str, bytes]]) -> dict[str, Metric]:
    """Return the metrics of a trial by name, sorted.

    Args:
        rows: names and data, in the order of the trial.

    Raises:
        ValueError: the data does not fit the names, or contains values that no run has.
    """
    blocks: dict[str, list[bytes]] = defaultdict(list)
    for joined, data in rows:
        blocks[joined].append(data)
    found: dict[str, list[Metric]] = defaultdict(list)
    for joined, parts in blocks.items():
        names = joined.split("\n")
        width = 2 + len(names)
        if any(not data or len(data) % (8 * width) for data in parts):
            raise ValueError("values of metrics without a name")
        table = np.frombuffer(b"".join(parts), "<f8").reshape(-1, width)
        where = table[:, :2]
        if not np.all((where >= 0) & (where < _MOST_STEPS) & (where == np.floor(where))):
            raise ValueError("a metric at a step that is no whole number")
        for column, name in enumerate(names, 2):
            found[name].append(Metric(table[:, 0], table[:, 1], table[:, column]))
    return {name: _in_order(found[name]) for name in sorted(found)}


def pack_parts(parts: Mapping[str, Part]) -> bytes:
    """Return the parts of metrics by name, as a checkpoint keeps them."""
    if not parts:
        return b""
    import msgspec  # slow to import

    return msgspec.msgpack.encode(parts)


def unpack_parts(saved: bytes) -> dict[str, Part]:
    """Return the parts of metrics by name.

    Raises:
        ExperimentError: the data of the checkpoint is damaged.
    """
    if not saved:
        return {}
    import msgspec  # slow to import

    try:
        return msgspec.msgpack.decode(saved, type=dict[str, Part])
    except msgspec.MsgspecError as error:
        raise ExperimentError(f"the metrics of a checkpoint are damaged: {error}") from None


def _in_order(parts: Sequence[Metric]) -> Metric:
    if len(parts) == 1:
        return parts[0]
    joined = [np.concatenate(columns) for columns in zip(*parts, strict=True)]
    order = np.argsort(joined[1], kind="stable")
    return Metric(*(column[order] for column in joined))


def pack_older(connection: sqlite3.Connection) -> None:
    """Pack the rows of the table `metrics`, each of which is a value, or one of several to be averaged.

    Values that were not yet averaged when a checkpoint was taken become a part of the checkpoint.
    """
    keys: dict[str, int] = {}
    checkpoints = dict(connection.execute("SELECT trial, episode FROM checkpoints"))
    for (trial,) in connection.execute("SELECT DISTINCT trial FROM metrics").fetchall():
        rows = connection.execute(
            """SELECT CAST(name AS TEXT), CAST(number AS INTEGER), CAST(step AS INTEGER),
                CAST(episode AS INTEGER), CAST(value AS REAL), CAST(every AS INTEGER), averaged FROM metrics
                WHERE trial = ? AND every >= 1 ORDER BY name, number""",
            (trial,),
        ).fetchall()
        values: dict[tuple[int, int], dict[str, float]] = defaultdict(dict)
        parts: dict[str, Part] = {}
        for name, group in itertools.groupby(rows, key=lambda row: row[0]):
            _average(name, group, checkpoints.get(trial, 0), values, parts)
        for episode, places in itertools.groupby(sorted(values), key=lambda at: at[0]):
            block = Block()
            block.add(episode, (Reading(step, values[episode, step]) for _, step in places))
            for names, data in block.data().items():
                if names not in keys:
                    connection.execute("INSERT INTO metric_names (names) VALUES (?)", (names,))
                    keys[names] = connection.execute("SELECT last_insert_rowid()").fetchone()[0]
                connection.execute(
                    "INSERT INTO readings VALUES (?, ?, ?, ?)", (trial, episode, keys[names], data)
                )
        if parts:
            connection.execute(
                "UPDATE checkpoints SET metrics = ? WHERE trial = ?", (pack_parts(parts), trial)
            )


def _average(
    name: str,
    rows: Iterable[Sequence[Any]],
    checkpoint: int,
    values: dict[tuple[int, int], dict[str, float]],
    parts: dict[str, Part],
) -> None:
    """Add a metric's values to `values`, by episode and step, and those that a checkpoint needs to `parts`.

    Args:
        name: of the metric.
        rows: name, number, step, episode, value, every and averaged, by number; NULL for NaN.
        checkpoint: episode after which the newest checkpoint was taken.
    """
    group, total, count = -1, 0.0, 0
    for _, number, step, episode, value, every, averaged in rows:
        known = float("nan") if value is None else value
        if averaged:
            if group != (group := (number - 1) // every):
                total, count = 0.0, 0
            total, count = total + known, count + 1
            known = total / count
            if episode <= checkpoint:
                parts[name] = Part(group, total, count)
        if number % every == 0:
            values[episode, step][name] = known
            if averaged and episode <= checkpoint:
                parts.pop(name, None)
