"""A run for a script or a notebook: its episodes as columns, NumPy arrays."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from experiment_runner.store.export import column_types, rows_by_trial
from experiment_runner.store.records import TrialRecord
from experiment_runner.store.results import Results
from glue.errors import ExperimentError
from glue.options import Value

if TYPE_CHECKING:
    import pandas as pd

__all__ = ["RunData", "load_run"]


class RunData(Mapping[str, npt.NDArray[Any]]):
    """The episodes of a run, a column by its name: `run["return"]`. Arrays of one length, (episodes,).

    trial, agent, environment   text: the trial's id, the labels of its players
    episode                     whole number, counts from 1 in each trial
    return                      float, undiscounted sum of the rewards; NaN when it is not a number
    steps                       whole number
    terminal                    bool, False when the step limit truncated the episode
    wall_time                   float, seconds
    seed                        whole number, of the trial
    agent.NAME,                 an option that the plan sets. Where a trial does not set it, text is
    environment.NAME            empty, and any other value NaN (such a column is of floats)

    Attributes:
        directory: of the run.
        trials: how far every trial is, in the order of the plan.
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
        """Return a data frame with these columns, a row for each episode.

        Raises:
            ExperimentError: pandas is not installed.
        """
        try:
            import pandas as pd
        except ImportError:
            raise ExperimentError("to_pandas needs pandas: pip install 'glue-rl[pandas]'") from None
        return pd.DataFrame(dict(self._columns))


def load_run(directory: str | os.PathLike[str]) -> RunData:
    """Return the episodes of a run directory, as far as they are recorded.

    Args:
        directory: made by glue-experiment (its --out), glue-results merge or glue-paper; it may be
            written to meanwhile.

    Raises:
        ExperimentError: there is no run, or it cannot be read.
    """
    with Results.open(Path(directory)) as results:
        types = column_types(results)
        rows = [row for rows in rows_by_trial(results, list(types)) for row in rows]
        trials = tuple(results.trials())
    cells = zip(*rows, strict=True) if rows else ((),) * len(types)
    columns = {name: _array(column, kind) for (name, kind), column in zip(types.items(), cells, strict=True)}
    return RunData(Path(directory), trials, columns)


def _array(cells: tuple[Value | None, ...], kind: type[Value]) -> npt.NDArray[Any]:
    if kind is str:
        return np.array(["" if cell is None else str(cell) for cell in cells], np.str_)
    return np.array(cells, float if None in cells else kind)  # None becomes NaN
