"""The episodes of a run as NumPy arrays, for a script or a notebook: the result of `glue.load_run`."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from experiment_runner.store.export import episode_table
from experiment_runner.store.records import TrialRecord
from experiment_runner.store.results import Results
from glue.errors import ExperimentError
from glue.installed import needing
from glue.options import Value
from glue.runs import RunData

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl


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
