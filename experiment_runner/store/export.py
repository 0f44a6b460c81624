"""A run's episodes as one table: CSV, JSON, Parquet.

A row is an episode. Its columns: trial, episode (from 1), return, steps, terminal (false when the step
limit truncated it), wall_time (seconds), seed of the trial, agent and environment (their labels), and
then a column for each option, `agent.step_size`, empty where the trial does not set it.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, TextIO

from experiment_runner.plan import RoleSpec, TrialSpec
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
_OWN: Final = 6  # of these columns are the episode's, the rest its trial's

Cell = Value | None


def column_types(results: Results) -> dict[str, type[Value]]:
    """Return the name of each column of a run, and the type that holds all its values.

    Options of several types are of floats if that holds them all, and of text if not.
    """
    found: dict[str, set[type[Value]]] = {}
    for record in results.trials():
        for name, value in _options(record.spec).items():
            found.setdefault(name, set()).add(type(value))
    return _FIXED | {name: _widest(types) for name, types in found.items()}


def rows_by_trial(results: Results, names: Sequence[str]) -> Iterator[list[list[Cell]]]:
    """Return the rows of one trial after the other, with these columns; None where there is no value.

    Trials without an episode are passed over.
    """
    for record in results.trials():
        spec = record.spec
        last: dict[str, Cell] = {"seed": spec.seed, "agent": _label(spec.agent)}
        last |= {"environment": _label(spec.environment), **_options(spec)}
        cells = [last.get(name) for name in names[_OWN:]]
        rows: list[list[Cell]] = [[spec.id, *episode, *cells] for episode in results.episodes(spec.id)]
        if rows:
            yield rows


def write_csv(results: Results, file: TextIO) -> None:
    """Write a header and a line for each episode; true and false in lower case."""
    names = list(column_types(results))
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(names)
    for rows in rows_by_trial(results, names):
        writer.writerows([str(c).lower() if isinstance(c, bool) else c for c in row] for row in rows)


def write_json(results: Results, file: TextIO) -> None:
    """Write an array of objects, one a line; a return that is infinite or not a number is null."""
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
    """Write a Parquet file, a row group for each trial.

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


def _label(role: RoleSpec | None) -> str:
    return "remote" if role is None else role.label


def _widest(types: set[type[Value]]) -> type[Value]:
    if len(types) == 1:
        return next(iter(types))
    return float if types == {int, float} else str
