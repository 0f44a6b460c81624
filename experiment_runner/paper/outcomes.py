"""What the experiments of Mohan (2010) came to: numbers from the run directories."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from experiment_runner.analysis.settings import Setting, collect
from experiment_runner.analysis.stats import (
    Estimate,
    bootstrap_rng,
    convergence_episode,
    estimate,
    mean,
    mean_of_last,
    running_mean,
)
from experiment_runner.paper.experiments import EXPERIMENTS, Level, PaperExperiment, Published, level_of
from experiment_runner.plan import RoleSpec
from experiment_runner.store.database import holds_run, reported
from experiment_runner.store.results import Results
from glue.core.local import local
from glue.errors import ExperimentError
from glue.options import build
from glue.players.loading import find
from glue.protocol.messages import Role

__all__ = ["FINISHED", "TOLERANCE", "WINDOW", "FloatArray", "Outcome", "load", "reach_episode"]

FloatArray = npt.NDArray[np.float64]

WINDOW: Final = 100
TOLERANCE: Final = 2.0
"""How far from its end, in reward, a running mean of `WINDOW` episodes counts as converged."""
FINISHED: Final = 90.0
"""The least return of an episode that reached the goal: 100, less 0.01 for each of at most 1000 steps.

No level has so many coins and monsters that an episode which ends in death comes near it.
"""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What one agent of an experiment did on one level.

    experiment  it belongs to
    agent       its label in the plan
    level       it played
    planned     how many trials there are to be
    curves      returns, (trials, episodes): of the trials that are finished; see `Setting.curves`
    values      of each trial that has a checkpoint, how many values the agent had learned by then
    steps       of all trials
    seconds     all episodes took, one after the other
    """

    experiment: PaperExperiment
    agent: str
    level: Level
    planned: int
    curves: FloatArray
    values: tuple[int, ...]
    steps: int
    seconds: float

    @property
    def published(self) -> Published | None:
        """The paper's numbers, where it has any for this."""
        faithful = self.agent == self.experiment.agents[0].label
        return self.experiment.published.get(self.level.difficulty) if faithful else None

    @property
    def rewards(self) -> FloatArray:
        """The mean of each trial's last episodes, (trials,)."""
        return np.array([mean_of_last(trial, WINDOW) for trial in self.curves])

    @property
    def reward(self) -> Estimate:
        """The mean of `rewards`, with its 95 % bootstrap interval."""
        return estimate([self.rewards], mean, bootstrap_rng())

    @property
    def reached(self) -> int | None:
        """When the mean curve first came where it ends; see `reach_episode`."""
        return reach_episode(mean(self.curves))

    @property
    def trials_reached(self) -> list[int]:
        """The same of each trial, ascending."""
        return _ascending(map(reach_episode, self.curves))

    @property
    def settled(self) -> int | None:
        """From when on the mean curve stayed where it ends: a relapse of a single trial can delay it."""
        return convergence_episode(mean(self.curves), WINDOW, TOLERANCE)

    @property
    def trials_settled(self) -> list[int]:
        """The same of each trial that settled, ascending."""
        return _ascending(convergence_episode(trial, WINDOW, TOLERANCE) for trial in self.curves)

    @property
    def finishing(self) -> FloatArray:
        """The share of each trial's last episodes that reached the goal, (trials,)."""
        return np.array([np.mean(trial[-WINDOW:] >= FINISHED) for trial in self.curves])

    @property
    def trials_finishing(self) -> int:
        """How many trials reached the goal in at least half of their last episodes."""
        return int(np.sum(self.finishing >= 0.5))


def reach_episode(returns: FloatArray) -> int | None:
    """Return the episode at which the running mean first came within `TOLERANCE` of its end, or above it.

    That is how fast an agent learned, whatever befell it later; None for less than `WINDOW` episodes.
    """
    means = running_mean(returns, WINDOW)
    return int(np.argmax(means >= means[-1] - TOLERANCE)) + WINDOW if means.size else None


def load(directory: Path) -> list[Outcome]:
    """Return what every agent did on every level, in the order of `EXPERIMENTS`, as far as it got.

    Args:
        directory: holds a run directory for each experiment that was begun, by its name.

    Raises:
        ExperimentError: one of them is the run of something else, or cannot be read.
    """
    outcomes = []
    for name, experiment in EXPERIMENTS.items():
        with reported(f"cannot read {directory / name}"):
            begun = holds_run(directory / name)
        if begun:
            with Results.open(directory / name) as results:
                found = [_outcome(experiment, setting, results) for setting in collect([results])]
            outcomes += [outcome for outcome in found if outcome.curves.size]
    return outcomes


def _outcome(experiment: PaperExperiment, setting: Setting, results: Results) -> Outcome:
    spec = setting.trials[0].spec
    if spec.agent is None or spec.environment is None:
        raise ExperimentError(f"{results.directory} is not a run of experiment {experiment.name}")
    episodes = [episode for trial in setting.trials for episode in results.episodes(trial.spec.id)]
    return Outcome(
        experiment,
        spec.agent.label,
        level_of(spec.environment),
        len(setting.trials),
        setting.curves(),
        _values(spec.agent, spec.environment, setting, results),
        sum(episode.steps for episode in episodes),
        sum(episode.wall_time for episode in episodes),
    )


def _values(agent: RoleSpec, environment: RoleSpec, setting: Setting, results: Results) -> tuple[int, ...]:
    """Return what agents brought back from the newest checkpoints answer to `values`."""
    found = [results.checkpoint(trial.spec.id) for trial in setting.trials]
    saved = [checkpoint.agent for _, checkpoint in filter(None, found)]
    if not saved:
        return ()
    answers = []
    with local(
        build(find(Role.AGENT, agent.name), agent.options),
        build(find(Role.ENVIRONMENT, environment.name), environment.options),
    ) as glue:
        glue.rl_init()
        for learned in saved:
            glue.rl_agent_load(learned)
            answers.append(glue.rl_agent_message("values"))
    return tuple(int(answer) for answer in answers if answer.isdecimal())


def _ascending(episodes: Iterable[int | None]) -> list[int]:
    return sorted(episode for episode in episodes if episode is not None)
