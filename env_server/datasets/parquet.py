"""Recordings as tables in Parquet; the recorded episodes that count and have a step."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final, NamedTuple

import pyarrow as arrow
from pyarrow import parquet

from glue.errors import ConfigError
from glue.trajectory import Ending, Run, TrajectoryError, TrajectoryReader
from glue.types import AbstractType, Action, Observation


class Played(NamedTuple):
    """An episode of T steps.

    run           its environment
    observations  T + 1 of them
    actions       T of them
    rewards       of each action
    terminal      whether the last step was terminal; otherwise the episode was truncated after it
    late          whether each action was late (see `glue.pace`)
    """

    run: Run
    observations: list[Observation]
    actions: list[Action]
    rewards: list[float]
    terminal: bool
    late: list[bool]


def played(readers: Sequence[TrajectoryReader]) -> Iterator[Played]:
    """Yield the recorded episodes that count, one at a time.

    Raises:
        TrajectoryError: a recording cannot be read or has no observations, or none has an episode.
    """
    empty = True
    for reader in readers:
        for episode in reader:
            if episode.ending is Ending.VOID or not episode.steps:
                continue
            empty = False
            observations = [episode.start, *(step.observation for step in episode.steps)]
            yield Played(
                episode.run,
                [_known(observation, reader) for observation in observations],
                [step.action for step in episode.steps],
                [step.reward for step in episode.steps],
                episode.ending is Ending.TERMINAL,
                [episode.is_late(step) for step in range(1, len(episode.steps) + 1)],
            )
    if empty:
        raise TrajectoryError(f"{', '.join(str(reader.path) for reader in readers)}: no episode that counts")


def _known(observation: Observation | None, reader: TrajectoryReader) -> Observation:
    if observation is None:
        raise TrajectoryError(f"{reader.path} holds actions only, and a dataset needs observations")
    return observation


_NUMBERS: Final = {"ints": arrow.list_(arrow.int32()), "doubles": arrow.list_(arrow.float64())}
_VALUE: Final = {**_NUMBERS, "chars": arrow.binary()}
_SCHEMA: Final = arrow.schema(
    [
        ("run", arrow.int32()),
        ("episode", arrow.int32()),
        ("step", arrow.int32()),
        *((f"observation_{name}", kind) for name, kind in _VALUE.items()),
        *((f"action_{name}", kind) for name, kind in _VALUE.items()),
        ("reward", arrow.float64()),
        ("terminal", arrow.bool_()),
        ("truncated", arrow.bool_()),
        ("late", arrow.bool_()),
    ]
)


def write_parquet(readers: Sequence[TrajectoryReader], path: Path) -> int:
    """Write the episodes of recordings to a file, with a row group for each.

    A row is an observation, the action taken there, its reward, and whether it ended the episode. The last
    row of an episode is its last observation, without an action. Runs, episodes and steps count from 0; the
    runs are in the file's metadata, as `runs`: JSON with the environment, its options, seed and task spec.

    Args:
        readers: the recordings.
        path: path of the file; an existing file is replaced once everything is written.

    Returns:
        The number of episodes.

    Raises:
        ConfigError: the file cannot be written.
        TrajectoryError: a recording cannot be read, has no observations, or none has an episode.
    """
    runs: list[Run] = []
    count = 0
    partial = path.with_name(f".{path.name}.partial")
    try:
        with parquet.ParquetWriter(partial, _SCHEMA) as writer:
            for episode in played(readers):
                if not runs or episode.run is not runs[-1]:
                    runs.append(episode.run)
                writer.write_table(_table(episode, len(runs) - 1, count))
                count += 1
            known = [{name: v for name, v in asdict(run).items() if name != "state"} for run in runs]
            writer.add_key_value_metadata({"runs": json.dumps(known)})
        partial.replace(path)
    except OSError as error:
        raise ConfigError(f"cannot write {path}: {error.strerror or error}") from None
    finally:
        partial.unlink(missing_ok=True)
    return count


def _table(episode: Played, run: int, number: int) -> Any:
    rows = len(episode.observations)
    ends = [False] * (rows - 2)
    columns = [
        [run] * rows,
        [number] * rows,
        range(rows),
        *_columns(episode.observations),
        *([*column, None] for column in _columns(episode.actions)),
        [*episode.rewards, None],
        [*ends, episode.terminal, None],
        [*ends, not episode.terminal, None],
        [*episode.late, None],
    ]
    arrays = [arrow.array(column, field.type) for column, field in zip(columns, _SCHEMA, strict=True)]
    return arrow.table(arrays, _SCHEMA)


def _columns(values: Sequence[AbstractType]) -> list[list[Any]]:
    return [[v.ints for v in values], [v.doubles for v in values], [v.chars for v in values]]
