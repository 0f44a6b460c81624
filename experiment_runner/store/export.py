"""A run's episodes as one table: CSV, JSON, Parquet.

Each row is an episode. The columns: trial, episode (from 1), return, steps, terminal (false when the step
limit truncated the episode), wall_time (seconds), seed (of the trial), agent and environment (labels), and
one for each option, such as `agent.step_size`, which is empty where the trial does not set it.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, TextIO

from experiment_runner.plan import REMOTE, TrialSpec
from experiment_runner.store.joined import joined_players
from experiment_runner.store.output import finite, written
from experiment_runner.store.results import Results
from glue.errors import ExperimentError
from glue.options import Value

__all__ = ["column_types", "rows_by_trial", "write_csv", "write_json", "write_parquet"]

_FIXED: Final[dict[str, type[Value]]] = {
    "trial": str,
    "episode": int,
    "return": float,
    "steps": int,
    "terminal": bool,
    "wall_time": float,
    "seed": int,
    "agent": str,
    "environment": str,
}
_EPISODE_COLUMNS: Final = 6  # the first of these; the others are the same in all episodes of a trial

Cell = Value | None


def column_types(results: Results) -> dict[str, type[Value]]:
    """Return the name of each column of a run, and the type of its values.

    An option whose values are ints and floats is a column of floats; of any other mixture, one of text.
    """
    found: dict[str, set[type[Value]]] = {}
    for record in results.trials():
        for name, value in _options(record.spec).items():
            found.setdefault(name, set()).add(type(value))
    return _FIXED | {name: _widest(types) for name, types in found.items()}


def rows_by_trial(results: Results, names: Sequence[str]) -> Iterator[list[list[Cell]]]:
    """Yield the rows of each trial, with the given columns; None where there is no value.

    Trials without an episode are skipped.
    """
    joined = joined_players(results)
    for record in results.trials():
        spec = record.spec
        shared: dict[str, Cell] = {
            "seed": spec.seed,
            "agent": spec.agent.label if spec.agent else joined.get((spec.id, "agent"), REMOTE),
            "environment": (
                spec.environment.label if spec.environment else joined.get((spec.id, "environment"), REMOTE)
            ),
            **_options(spec),
        }
        cells = [shared.get(name) for name in names[_EPISODE_COLUMNS:]]
        rows: list[list[Cell]] = [[spec.id, *episode, *cells] for episode in results.episodes(spec.id)]
        if rows:
            yield rows


def write_csv(results: Results, file: TextIO) -> None:
    """Write a header and a line for each episode; booleans are `true` and `false`."""
    names = list(column_types(results))
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(names)
    for rows in rows_by_trial(results, names):
        writer.writerows([str(c).lower() if isinstance(c, bool) else c for c in row] for row in rows)


def write_json(results: Results, file: TextIO) -> None:
    """Write an array of objects, one on each line; a return that is infinite or NaN is null."""
    names = list(column_types(results))
    file.write("[")
    separator = "\n"
    for rows in rows_by_trial(results, names):
        for row in rows:
            cells = {n: c for n, c in zip(names, row, strict=True) if c is not None}
            file.write(separator + json.dumps({n: finite(c) for n, c in cells.items()}, ensure_ascii=False))
            separator = ",\n"
    file.write("\n]\n")


def write_parquet(results: Results, path: Path) -> None:
    """Write a Parquet file with a row group for each trial.

    Raises:
        ExperimentError: pyarrow is not installed, or the file cannot be written.
    """
    try:
        import pyarrow as arrow  # type: ignore[import-untyped]  # it has no types
        from pyarrow import parquet
    except ImportError:
        raise ExperimentError("Parquet needs pyarrow: pip install 'glue-rl[parquet]'") from None
    types = column_types(results)
    arrow_types = {bool: arrow.bool_(), int: arrow.int64(), float: arrow.float64(), str: arrow.string()}
    schema = arrow.schema([(name, arrow_types[types[name]]) for name in types])
    with written(path) as partial, parquet.ParquetWriter(partial, schema) as writer:
        for rows in rows_by_trial(results, list(types)):
            cells = zip(types, zip(*rows, strict=True), strict=True)
            arrays = [[None if c is None else types[name](c) for c in column] for name, column in cells]
            writer.write_table(arrow.table(arrays, schema))


def _options(spec: TrialSpec) -> dict[str, Value]:
    roles = (("agent", spec.agent), ("environment", spec.environment))
    return {f"{name}.{o}": value for name, role in roles if role for o, value in role.options.items()}


def _widest(types: set[type[Value]]) -> type[Value]:
    if len(types) == 1:
        return next(iter(types))
    return float if types == {int, float} else str
