"""Recordings as datasets of Minari, the collection of the Farama Foundation."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from contextlib import redirect_stdout
from io import StringIO
from operator import mul
from typing import Any, Final, NamedTuple

import minari
import numpy as np
import numpy.typing as npt
from gymnasium import spaces
from minari.data_collector import EpisodeBuffer
from minari.dataset.minari_dataset import parse_dataset_id

from env_server.datasets.parquet import Played, played
from glue.errors import ConfigError, TaskSpecError
from glue.gym.spaces import Codec, read_spaces
from glue.taskspec import parse_task_spec
from glue.trajectory import Run, TrajectoryReader
from glue.types import AbstractType, arrays_of

_MOST_BYTES: Final = 2**30
"""Maximum bytes of an episode's padded observations or actions: a single large one enlarges all."""

_SIZES: Final = (4, 8, 1)
"""Bytes of an int, a double and a char."""
_INT32: Final = np.iinfo(np.int32)


def write_minari(readers: Sequence[TrajectoryReader], dataset_id: str) -> int:
    """Write the episodes of recordings to a new dataset in Minari's folder of datasets.

    The spaces are those of the task spec; where it does not state the counts, see `padded`.

    Args:
        readers: the recordings, of one task spec.
        dataset_id: as in `mines/sarsa-v0`.

    Returns:
        The number of episodes.

    Raises:
        ConfigError: the id is malformed or taken, the task specs differ or cannot be read, or the dataset
            cannot be written.
        TrajectoryError: a recording cannot be read, has no observations, or none has an episode.
        SimulatorError: a recorded value is not in the space of its task spec.
    """
    try:
        parse_dataset_id(dataset_id)
    except (TypeError, ValueError):  # TypeError: it has no version
        raise ConfigError(
            f"an id of Minari is like mines/sarsa-v0, with a version at its end, not {dataset_id}"
        ) from None
    try:
        return _write(readers, dataset_id)
    except OSError as error:
        raise ConfigError(f"cannot write the dataset {dataset_id}: {error}") from None


def _write(readers: Sequence[TrajectoryReader], dataset_id: str) -> int:
    if dataset_id in minari.list_local_datasets():
        raise ConfigError(f"there is a dataset {dataset_id} already: choose another version")
    survey = _survey(readers)
    observations, actions = survey.conversions()
    run = survey.run
    buffers = (
        EpisodeBuffer(
            observations=stacked([observations[1](each) for each in episode.observations]),
            actions=stacked([actions[1](each) for each in episode.actions]),
            rewards=episode.rewards,
            terminations=_last(episode, episode.terminal),
            truncations=_last(episode, not episode.terminal),
        )
        for episode in played(readers)
    )
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # about a missing author, and so on
            written = minari.create_dataset_from_buffers(
                dataset_id,
                buffers,
                observation_space=observations[0],
                action_space=actions[0],
                description=f"{run.environment} {dict(run.options)}, seed {run.seed}, recorded by glue-rl",
                jpeg_encoding=False,  # JPEG would change the observations
            )
    except BaseException:
        if dataset_id in minari.list_local_datasets():
            with redirect_stdout(StringIO()):
                minari.delete_dataset(dataset_id)
        raise
    return int(written.total_episodes)


class _Survey(NamedTuple):
    """The properties of all episodes that the spaces depend on.

    run           the first run
    observations  the largest counts of observations
    actions       the largest counts of actions
    steps         the largest number of steps
    """

    run: Run
    observations: Counts
    actions: Counts
    steps: int

    def conversions(self) -> tuple[Conversion, Conversion]:
        """Return the conversions of observations and actions."""
        try:
            spec = parse_task_spec(self.run.task_spec)
        except TaskSpecError as error:
            raise ConfigError(f"the task spec of the recording cannot be read: {error}") from None
        observations, actions = read_spaces(spec)
        return (
            stated(observations) if spec.observations.stated else self._padded(self.observations),
            stated(actions) if spec.actions.stated else self._padded(self.actions),
        )

    def _padded(self, most: Counts) -> Conversion:
        size = (self.steps + 1) * sum(map(mul, most, _SIZES))
        if size > _MOST_BYTES:
            raise ConfigError(
                f"the largest observation makes an episode of {size} bytes, as all are padded to its size: "
                "write Parquet instead"
            )
        return padded(most)


def _survey(readers: Sequence[TrajectoryReader]) -> _Survey:
    found: _Survey | None = None
    for episode in played(readers):
        found = found or _Survey(episode.run, (0, 0, 0), (0, 0, 0), 0)
        if episode.run.task_spec != found.run.task_spec:
            raise ConfigError("the recordings have different task specs: make a dataset of each")
        found = _Survey(
            found.run,
            _most(found.observations, episode.observations),
            _most(found.actions, episode.actions),
            max(found.steps, len(episode.actions)),
        )
    assert found is not None  # or `played` has raised
    return found


def _most(counts: Counts, values: Sequence[AbstractType]) -> Counts:
    ints, doubles, chars = (max(one) for one in zip(counts, *(v.counts for v in values), strict=True))
    return ints, doubles, chars


def _last(episode: Played, ended: bool) -> npt.NDArray[np.bool_]:
    """Return a flag for each step: `ended` for the last, False for all others."""
    flags = np.zeros(len(episode.actions), np.bool_)
    flags[-1] = ended
    return flags


Counts = tuple[int, int, int]
"""Numbers of ints, doubles and chars."""

Conversion = tuple[spaces.Space[Any], Callable[[AbstractType], Any]]
"""A space, and a function that turns an observation or action into a value of the space."""


def stated(space: spaces.Space[Any]) -> Conversion:
    """Return the conversion for the space of a task spec."""
    return space, Codec(space).unpack


def padded(most: Counts) -> Conversion:
    """Return the conversion to zero-padded arrays and `counts`, the numbers of values before padding.

    Args:
        most: the largest counts; a kind whose count is 0 is left out.
    """
    boxes = {
        "ints": spaces.Box(_INT32.min, _INT32.max, (most[0],), np.int32),
        "doubles": spaces.Box(-np.inf, np.inf, (most[1],), np.float64),
        "chars": spaces.Box(0, 255, (most[2],), np.uint8),
    }
    found = {name: box for (name, box), count in zip(boxes.items(), most, strict=True) if count}
    found["counts"] = spaces.Box(0, _INT32.max, (3,), np.int32)

    def convert(value: AbstractType) -> dict[str, Any]:
        numbers = {**arrays_of(value), "counts": np.array(value.counts, np.int32)}
        return {
            name: np.concatenate([numbers[name], np.zeros(box.shape[0] - len(numbers[name]), box.dtype)])
            for name, box in found.items()
        }

    return spaces.Dict(found), convert


def stacked(values: list[Any]) -> Any:
    """Return values of a space, one for each step, as one value of arrays whose first axis is the step."""
    first = values[0]
    if isinstance(first, dict):
        return {name: stacked([value[name] for value in values]) for name in first}
    if isinstance(first, tuple):
        return tuple(stacked(list(parts)) for parts in zip(*values, strict=True))
    return np.stack(values)
