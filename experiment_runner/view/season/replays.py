"""Records of a competition, played again for the page: they hold actions, and the environment the pictures.

An environment is deterministic, so it has to play all episodes up to the one that is shown.
"""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path
from typing import Final

from starlette.exceptions import HTTPException

from experiment_runner.competition.records.replay import made_for
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.view.episodes import packed
from glue.errors import ExperimentError
from glue.trajectory import TrajectoryReader
from glue.trajectory.records import Steps
from glue.types import Observation, step_of

_MOST_STEPS: Final = 300_000
"""Of all episodes up to the one that is shown: some seconds of a core."""

_MOST_BYTES: Final = 64 * 2**20
_REWARD: Final = struct.Struct("<d")


def replayed(name: str, spec: TrialSpec, path: Path, wanted: int) -> bytes:
    """Return an episode of a verified record, with the observations that its environment shows again.

    Args:
        name: of the record, for display.
        spec: the trial that it is of.
        path: of the record.
        wanted: number of the episode, from 1.

    Raises:
        ExperimentError: the episode is too long for the page.
        HTTPException: there is no such episode.
    """
    environment = made_for(spec)
    environment.env_init()
    left = _MOST_STEPS
    for count, episode in enumerate(TrajectoryReader(path), 1):
        left -= len(episode.steps)
        if left < 0:
            raise ExperimentError(
                f"the page plays at most {_MOST_STEPS:,} steps of a trial again: glue-replay shows the rest"
            )
        start = environment.env_start()
        shown = Observation.from_body(start.body)  # the environment may use its own again
        steps = Steps()
        size = 0
        for step in episode.steps:
            found = step_of(environment.env_step(step.action))
            if count == wanted:
                observation = found.observation.body
                size += len(observation)
                if size > _MOST_BYTES:
                    raise ExperimentError("the episode is too large for the page: glue-replay shows it")
                steps.append(_REWARD.pack(step.reward), step.action.body, observation, step.terminal)
        if count == wanted:
            return packed(name, count, replace(episode, start=shown, steps=steps))
    raise HTTPException(404, f"the trial has no episode {wanted}")
