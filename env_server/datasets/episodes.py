"""The episodes of a dataset: the recorded episodes that count and have a step."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from glue.trajectory import Ending, Run, TrajectoryError, TrajectoryReader
from glue.types import Action, Observation


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
