"""A run as one table: CSV, JSON, Parquet; and its episodes as NumPy arrays: the result of `glue.load_run`.

Each row is an episode or, over steps, a window of steps. The columns of an episode: trial, episode (from 1),
the measures of an episode (return, steps, terminal: false when the step limit truncated it, wall_time in
seconds), the extras that were recorded, seed (of the trial), agent and environment (labels), and one for each
option, such as `agent.step_size`, which is empty where the trial does not set it.

The extras that a run has recorded, as columns of its episodes.

They are stored as metrics that are called by the environment's label, a dot, and the extra's name.

Files are replaced as a whole; JSON has only numbers that it can represent, and CSV no formulas.
"""

from __future__ import annotations

import contextlib
import csv
import json
import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, NamedTuple, TextIO

import numpy as np
import numpy.typing as npt

from experiment_runner.plan.plan import TrialSpec
from experiment_runner.store.database import reported
from experiment_runner.store.records import MEASURES, TrialRecord, known_measures
from experiment_runner.store.results import Results
from glue.console import cell
from glue.errors import ExperimentError
from glue.installed import needing
from glue.options import Value
from glue.runs import RunData

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl


def finite(value: object) -> object:
    """Return `value`, or None if it is infinite or NaN, which JSON cannot represent."""
    return None if isinstance(value, float) and not math.isfinite(value) else value


def csv_row(cells: Sequence[object]) -> list[object]:
    """Return the cells of a row of CSV: booleans are `true` and `false`, and no text is a formula."""
    return [
        str(value).lower() if isinstance(value, bool) else cell(value) if isinstance(value, str) else value
        for value in cells
    ]


@contextlib.contextmanager
def written(path: Path) -> Iterator[Path]:
    """Yield a temporary path to write to; it is renamed to `path` at the end, or removed on an exception.

    A device or pipe, such as /dev/stdout, is written to directly.

    Raises:
        ExperimentError: the file cannot be written.
    """
    with reported(f"cannot write {path}"):
        if path.exists() and not path.is_file():
            yield path  # a pipe has no other: a link to it leads to no path
            return
        target = path.resolve()  # a symbolic link is not replaced
        partial = target.with_name(f".{target.name}.{os.getpid()}")
        try:
            yield partial
            partial.replace(target)
        finally:
            partial.unlink(missing_ok=True)


_TAKEN: Final = {"trial", "episode", *MEASURES, "reward", "seed", "agent", "environment"}
_PREFIXES: Final = ("agent.", "environment.", "extra.")


def extra_columns(results: Results) -> list[str]:
    """Return the names of the columns of a run's extras, sorted.

    They are those of the extras; one that is, or may be, the name of another column follows `extra.`.
    """
    metrics = results.metric_names()
    labels = {f"{record.spec.environment_label}." for record in results.trials()} if metrics else set()
    return sorted({_column(name, label) for label in labels for name in metrics if name.startswith(label)})


def extras_of(results: Results, spec: TrialSpec) -> dict[str, npt.NDArray[np.float64]]:
    """Return the extras of a trial by column: the number of each episode so far, NaN where it has none."""
    label = f"{spec.environment_label}."
    episodes = len(results.measure(spec.id, "steps"))
    columns = {}
    for name, metric in results.metrics(spec.id).items():
        if name.startswith(label):
            column = columns[_column(name, label)] = np.full(episodes, np.nan)
            known = (metric.episodes >= 1) & (metric.episodes <= episodes)  # another may have ended meanwhile
            column[metric.episodes[known].astype(int) - 1] = metric.values[known]
    return columns


def _column(metric: str, label: str) -> str:
    name = metric.removeprefix(label)
    return f"extra.{name}" if name in _TAKEN or name.startswith(_PREFIXES) else name


_EPISODE: Final[dict[str, type[Value]]] = {
    "trial": str,
    "episode": int,
    **{name: measure.kind for name, measure in MEASURES.items()},
}
_TRIAL: Final[dict[str, type[Value]]] = {"seed": int, "agent": str, "environment": str}

Cell = Value | None


class Table(NamedTuple):
    """A table of a run.

    types  name of each column, and the type of its values; an option with both ints and floats is a column of
           floats, one with any other mixture a column of text
    rows   the rows of each trial that has any, one cell for each column; None where there is no value
    """

    types: dict[str, type[Value]]
    rows: Iterator[list[list[Cell]]]


def episode_table(results: Results) -> Table:
    """Return the table of a run's episodes."""
    columns = extra_columns(results)

    def rows(spec: TrialSpec) -> Iterator[list[Cell]]:
        episodes = results.episodes(spec.id)
        extras = extras_of(results, spec) if columns else {}
        for i, episode in enumerate(episodes):
            numbers = [float(extras[name][i]) if name in extras else math.nan for name in columns]
            found = [None if math.isnan(number) else number for number in numbers]
            yield [episode.episode, *map(known_measures(episode).get, MEASURES), *found]

    return table_of(results, {**_EPISODE, **dict.fromkeys(columns, float)}, rows)


def metric_table(results: Results) -> Table:
    """Return the table of all values of the agents' metrics."""

    def rows(spec: TrialSpec) -> Iterator[list[Cell]]:
        for name, metric in results.metrics(spec.id).items():
            for episode, step, value in zip(*metric, strict=True):
                yield [name, int(episode), int(step), float(value)]

    first = {"trial": str, "metric": str, "episode": int, "step": int, "value": float}
    return table_of(results, first, rows)


def table_of(
    results: Results, first: Mapping[str, type[Value]], rows: Callable[[TrialSpec], Iterable[list[Cell]]]
) -> Table:
    """Return a table of a run.

    Args:
        results: of the run.
        first: the first columns, beginning with the trial's id.
        rows: returns a trial's rows, without the id; the cells of the seed, the players and their options
            follow them.
    """
    found: dict[str, set[type[Value]]] = {}
    for record in results.trials():
        for name, value in _options(record.spec).items():
            found.setdefault(name, set()).add(type(value))
    types = {**first, **_TRIAL, **{name: _widest(kinds) for name, kinds in found.items()}}
    return Table(types, _rows(results, [*types][len(first) :], rows))


def _rows(
    results: Results, names: Sequence[str], rows: Callable[[TrialSpec], Iterable[list[Cell]]]
) -> Iterator[list[list[Cell]]]:
    joined = results.joined_players()
    for record in results.trials():
        spec = record.spec
        settings = settings_of(spec, joined)
        cells = [settings.get(name) for name in names]
        if found := [[spec.id, *row, *cells] for row in rows(spec)]:
            yield found


def settings_of(spec: TrialSpec, joined: Mapping[tuple[str, str], str]) -> dict[str, Cell]:
    """Return the seed, players and options of a trial, under the names of their columns.

    Args:
        spec: the trial.
        joined: names of players from outside, by trial and role.
    """
    return {"seed": spec.seed, **spec.labels(joined), **_options(spec)}


def write_csv(table: Table, file: TextIO) -> None:
    """Write a header and a line for each row."""
    writer = csv.writer(file, lineterminator="\n")
    writer.writerow(csv_row([*table.types]))
    for rows in table.rows:
        writer.writerows(map(csv_row, rows))


def write_json(table: Table, file: TextIO) -> None:
    """Write an array of objects, one on each line; a number that is infinite or NaN is null."""
    file.write("[")
    separator = "\n"
    for rows in table.rows:
        for row in rows:
            cells = {n: c for n, c in zip(table.types, row, strict=True) if c is not None}
            file.write(separator + json.dumps({n: finite(c) for n, c in cells.items()}))
            separator = ",\n"
    file.write("\n]\n")


def write_parquet(table: Table, path: Path) -> None:
    """Write a Parquet file with a row group for each trial.

    Raises:
        ExperimentError: pyarrow is not installed, or the file cannot be written.
    """
    with needing("parquet", "Parquet needs pyarrow", ExperimentError):
        import pyarrow as arrow
        from pyarrow import parquet
    types = table.types
    arrow_types = {bool: arrow.bool_(), int: arrow.int64(), float: arrow.float64(), str: arrow.string()}
    with written(path) as partial:
        schema = arrow.schema([(name, arrow_types[types[name]]) for name in types])
        with parquet.ParquetWriter(partial, schema) as writer:
            for rows in table.rows:
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


class StoredRun(RunData):
    """The columns of a run directory.

    Attributes:
        trials: the record of every trial, in the order of the plan.
    """

    def __init__(
        self, directory: Path, trials: tuple[TrialRecord, ...], columns: Mapping[str, npt.NDArray[Any]]
    ) -> None:
        self.directory = directory
        self.trials = trials
        self._columns = MappingProxyType(dict(columns))

    def __getitem__(self, name: str) -> npt.NDArray[Any]:
        return self._columns[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._columns)

    def __len__(self) -> int:
        return len(self._columns)

    def __repr__(self) -> str:
        episodes = len(self["episode"])
        return f"<run {self.directory}: {len(self.trials)} trials, {episodes} episodes; {', '.join(self)}>"

    def to_pandas(self) -> pd.DataFrame:
        with needing("pandas", "to_pandas needs pandas", ExperimentError):
            import pandas as pd
        return pd.DataFrame(dict(self._columns))

    def to_polars(self) -> pl.DataFrame:
        with needing("polars", "to_polars needs polars", ExperimentError):
            import polars as pl
        return pl.DataFrame(dict(self._columns))


def load_run(directory: str | os.PathLike[str]) -> StoredRun:
    """Return the episodes of a run directory; see `glue.load_run`."""
    with Results.open(Path(directory)) as results:
        types, by_trial = episode_table(results)
        rows = [row for rows in by_trial for row in rows]
        trials = tuple(results.trials())
    cells = zip(*rows, strict=True) if rows else ((),) * len(types)
    columns = {name: _array(column, kind) for (name, kind), column in zip(types.items(), cells, strict=True)}
    return StoredRun(Path(directory), trials, columns)


def _array(cells: tuple[Value | None, ...], kind: type[Value]) -> npt.NDArray[Any]:
    if kind is str:
        return np.array(["" if cell is None else str(cell) for cell in cells], np.str_)
    # None becomes NaN, the value of a measure in episodes that were recorded without it.
    return np.array(cells, kind if {*map(type, cells)} <= {kind} else float)
