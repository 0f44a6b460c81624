"""The readings of agents' metrics as rows of the database, one for each episode and set of names.

The data of a row is a matrix of doubles, little-endian, with a row for each reading: its step, then the value
of each name. To store each value as a row of its own takes several times as long, which shows where an
episode takes a quarter of a millisecond.
"""

from __future__ import annotations

import itertools
import sqlite3
import struct
from collections import defaultdict
from collections.abc import Iterable, Sequence
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
import numpy.typing as npt

from experiment_runner.store.records import Reading

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


NO_METRIC: Final = Metric(np.empty(0), np.empty(0), np.empty(0))


def packed(readings: Iterable[Reading]) -> dict[str, bytes]:
    """Return the data of the readings of an episode, by the names of their values, a line each."""
    numbers: dict[str, list[float]] = {}
    for step, values in readings:
        numbers.setdefault("\n".join(values), []).extend((step, *values.values()))
    return {names: struct.pack(f"<{len(row)}d", *row) for names, row in numbers.items()}


def unpacked(rows: Iterable[tuple[int, str, bytes]]) -> dict[str, Metric]:
    """Return the metrics of a trial by name, sorted.

    Args:
        rows: episode, names and data, by episode.

    Raises:
        ValueError: the data does not fit the names, or a step is not a number of steps.
    """
    by_names: dict[str, list[tuple[int, bytes]]] = defaultdict(list)
    for episode, names, data in rows:
        by_names[names].append((episode, data))
    found: dict[str, list[Metric]] = defaultdict(list)
    for text, members in by_names.items():
        names = text.split("\n")
        size = 8 * (1 + len(names))
        if any(len(data) % size for _, data in members):
            raise ValueError("values of metrics without a name")
        table = np.frombuffer(b"".join(data for _, data in members), "<f8").reshape(-1, 1 + len(names))
        steps = table[:, 0]
        if not np.all((steps >= 0) & (steps < _MOST_STEPS) & (steps == np.floor(steps))):
            raise ValueError("a metric at a step that is no whole number")
        counts = [len(data) // size for _, data in members]
        episodes = np.repeat([float(episode) for episode, _ in members], counts)
        for column, name in enumerate(names, 1):
            found[name].append(Metric(episodes, steps, table[:, column]))
    return {name: _in_order(found[name]) for name in sorted(found)}


def _in_order(parts: Sequence[Metric]) -> Metric:
    if len(parts) == 1:
        return parts[0]
    joined = [np.concatenate(columns) for columns in zip(*parts, strict=True)]
    order = np.argsort(joined[1], kind="stable")
    return Metric(*(column[order] for column in joined))


def pack_older(connection: sqlite3.Connection) -> None:
    """Pack the rows of the table `metrics`, each of which is a value, or one of those that are averaged.

    Values that are not averaged yet, when a checkpoint was taken, become a part of the checkpoint.
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
        parts: dict[str, tuple[int, float, int]] = {}
        for name, group in itertools.groupby(rows, key=lambda row: row[0]):
            _average(name, group, checkpoints.get(trial, 0), values, parts)
        for episode, readings in itertools.groupby(sorted(values), key=lambda at: at[0]):
            for names, data in packed(Reading(at[1], values[at]) for at in readings).items():
                if names not in keys:
                    connection.execute("INSERT INTO metric_names (names) VALUES (?)", (names,))
                    keys[names] = connection.execute("SELECT last_insert_rowid()").fetchone()[0]
                connection.execute(
                    "INSERT INTO readings VALUES (?, ?, ?, ?)", (trial, episode, keys[names], data)
                )
        if parts:
            saved = msgspec.msgpack.encode(parts)
            connection.execute("UPDATE checkpoints SET metrics = ? WHERE trial = ?", (saved, trial))


def _average(
    name: str,
    rows: Iterable[Sequence[Any]],
    checkpoint: int,
    values: dict[tuple[int, int], dict[str, float]],
    parts: dict[str, tuple[int, float, int]],
) -> None:
    """Add the values of a metric to `values`, by episode and step, and to `parts` what a checkpoint needs.

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
                parts[name] = (group, total, count)
        if number % every == 0:
            values[episode, step][name] = known
            if averaged and episode <= checkpoint:
                parts.pop(name, None)
