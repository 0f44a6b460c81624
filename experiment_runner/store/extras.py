"""The extras that a run has recorded, as columns of its episodes.

They are stored as metrics that are called by the environment's label, a dot, and the extra's name.
"""

from __future__ import annotations

from typing import Final

import numpy as np
import numpy.typing as npt

from experiment_runner.plan.plan import TrialSpec
from experiment_runner.store.records import MEASURES
from experiment_runner.store.results import Results

_TAKEN: Final = {"trial", "episode", *MEASURES, "reward", "seed", "agent", "environment"}
_OPTIONS: Final = ("agent.", "environment.")


def extra_columns(results: Results) -> list[str]:
    """Return the names of the columns of a run's extras, sorted.

    They are those of the extras; one that is the name of another column follows `extra.`.
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
    return f"extra.{name}" if name in _TAKEN or name.startswith(_OPTIONS) else name
