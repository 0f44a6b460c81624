"""Load the results of experiments, through an entry point of the package that stores them.

The group is `glue.runs`, and its only entry `load_run`. Thus users write `glue.load_run`, and glue does not
import that package.
"""

from __future__ import annotations

import os
from abc import abstractmethod
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy.typing as npt

from glue.errors import ConfigError
from glue.installed import entry_points

if TYPE_CHECKING:
    import pandas as pd
    import polars as pl


class RunData(Mapping[str, npt.NDArray[Any]]):
    """The episodes of a run as columns, `run["return"]`: arrays of one length, (episodes,).

    trial, agent, environment   text: the trial's id, the labels of its players
    episode                     int, counts from 1 in each trial
    return                      float, undiscounted sum of the rewards; may be NaN
    steps                       int
    terminal                    bool, False when the step limit truncated the episode
    wall_time                   float, seconds
    seed                        int, the seed of the trial
    agent.NAME,                 an option that the plan sets. Where a trial does not set it, text is
    environment.NAME            empty, and any other value NaN (such a column is of floats)

    Attributes:
        directory: the run's directory.
    """

    directory: Path

    @abstractmethod
    def to_pandas(self) -> pd.DataFrame:
        """Return a data frame with these columns, a row for each episode.

        Raises:
            ExperimentError: pandas is not installed.
        """

    @abstractmethod
    def to_polars(self) -> pl.DataFrame:
        """Return a data frame of polars with these columns, a row for each episode.

        Raises:
            ExperimentError: polars is not installed.
        """


def load_run(directory: str | os.PathLike[str]) -> RunData:
    """Return the episodes recorded so far in a run directory.

    Args:
        directory: written by glue-experiment (its --out), glue-results merge or glue-paper. The run may
            still be under way.

    Raises:
        ExperimentError: the directory holds no run, or the run cannot be read.
        ConfigError: the package that reads runs is not installed.
    """
    for entry_point in entry_points("glue.runs").select(name="load_run"):
        return cast(RunData, entry_point.load()(directory))
    raise ConfigError("load_run needs the package experiment_runner: pip install glue-rl")
