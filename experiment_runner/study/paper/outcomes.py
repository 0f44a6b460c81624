"""The results of the experiments of Mohan (2010), computed from the run directories."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from experiment_runner.analysis import stats
from experiment_runner.analysis.settings import Setting, collect
from experiment_runner.plan.plan import RoleSpec
from experiment_runner.store.layout import is_run
from experiment_runner.store.results import Results
from experiment_runner.study.paper import experiments
from glue.engine.local import local
from glue.errors import ExperimentError
from glue.options import build
from glue.plugins.loading import find
from glue.wire.messages import Role

WINDOW: Final = 100
TOLERANCE: Final = 2.0
"""Distance in reward from its final value within which a running mean of `WINDOW` episodes has converged."""
FINISHED: Final = 90.0
"""The minimum return of an episode that reached the goal: 100, less 0.01 for each of at most 1000 steps.

No level has enough coins and monsters for an episode that ends in death to get close to it.
"""


@dataclass(frozen=True, slots=True)
class LevelResults:
    """The results of one agent of an experiment on one level.

    experiment  the experiment
    agent       the agent's label in the plan
    level       the level
    planned     number of trials in the plan
    curves      returns of the finished trials, (trials, episodes); see `Setting.curves`
    values      number of learned values at the newest checkpoint, for each trial that has one
    steps       total of all trials
    seconds     total duration of all episodes
    cycles      mean number of decision cycles of an episode up to the newest checkpoint, for each trial whose
                agent counts them
    episodes    number in all trials, also in unfinished ones
    """

    experiment: experiments.PaperExperiment
    agent: str
    level: experiments.PaperLevel
    planned: int
    curves: stats.FloatArray
    values: tuple[int, ...]
    steps: int
    seconds: float
    cycles: tuple[float, ...] = ()
    episodes: int = 0

    @property
    def published(self) -> experiments.Published | None:
        """The paper's numbers, None if it has none for this agent and level."""
        faithful = self.agent == self.experiment.agents[0].label
        return self.experiment.published.get(self.level.difficulty) if faithful else None

    @property
    def rewards(self) -> stats.FloatArray:
        """The mean return of each trial's last `WINDOW` episodes, (trials,)."""
        return np.array([stats.mean_of_last(trial, WINDOW) for trial in self.curves])

    @property
    def reward(self) -> stats.Estimate:
        """The mean of `rewards`, with its 95 % bootstrap interval."""
        return stats.estimate([self.rewards], stats.mean, stats.bootstrap_rng())

    @property
    def reached(self) -> int | None:
        """The episode at which the mean curve first reached its final value; see `reach_episode`."""
        return reach_episode(stats.mean(self.curves))

    @property
    def trials_reached(self) -> list[int]:
        """The value of `reached` of each trial, ascending."""
        return _ascending(map(reach_episode, self.curves))

    @property
    def settled(self) -> int | None:
        """The episode from which the mean curve stayed at its final value, None if it did not.

        A relapse of a single trial can delay it; see `convergence_episode`.
        """
        return stats.convergence_episode(stats.mean(self.curves), WINDOW, TOLERANCE)

    @property
    def trials_settled(self) -> list[int]:
        """The value of `settled` of each trial that settled, ascending."""
        return _ascending(stats.convergence_episode(trial, WINDOW, TOLERANCE) for trial in self.curves)

    @property
    def finishing(self) -> stats.FloatArray:
        """The share of each trial's last `WINDOW` episodes that reached the goal, 0 to 1, (trials,)."""
        return np.array([np.mean(trial[-WINDOW:] >= FINISHED) for trial in self.curves])

    @property
    def trials_finishing(self) -> int:
        """The number of trials that reached the goal in at least half of their last `WINDOW` episodes."""
        return int(np.sum(self.finishing >= 0.5))


def reach_episode(returns: stats.FloatArray) -> int | None:
    """Return the episode at which the running mean is first at least its final value less `TOLERANCE`.

    It shows how fast an agent learns, regardless of later relapses. None for fewer than `WINDOW` episodes.
    """
    means = stats.running_mean(returns, WINDOW)
    return int(np.argmax(means >= means[-1] - TOLERANCE)) + WINDOW if means.size else None


def load(directory: Path) -> list[LevelResults]:
    """Return the results so far of each agent on each level, in the order of `EXPERIMENTS`.

    Args:
        directory: contains the run directories, each with the name of its experiment.

    Raises:
        ExperimentError: one of the runs is not of this study, or cannot be read.
    """
    outcomes = []
    for name, experiment in experiments.EXPERIMENTS.items():
        if is_run(directory / name):
            with Results.open(directory / name) as results:
                found = [_outcome(experiment, setting, results) for setting in collect([results])]
            outcomes += [outcome for outcome in found if outcome.curves.size]
    return outcomes


def _outcome(experiment: experiments.PaperExperiment, setting: Setting, results: Results) -> LevelResults:
    spec = setting.trials[0].spec
    if spec.agent is None or spec.environment is None:
        raise ExperimentError(f"{results.directory} is not a run of experiment {experiment.name}")
    episodes = [episode for trial in setting.trials for episode in results.episodes(trial.spec.id)]
    values, cycles = _answers(spec.agent, spec.environment, setting, results)
    return LevelResults(
        experiment,
        spec.agent.label,
        experiments.level_of(spec.environment),
        len(setting.trials),
        setting.curves(),
        values,
        sum(episode.steps for episode in episodes),
        sum(episode.wall_time for episode in episodes),
        cycles,
        len(episodes),
    )


def _answers(
    agent: RoleSpec, environment: RoleSpec, setting: Setting, results: Results
) -> tuple[tuple[int, ...], tuple[float, ...]]:
    """Return the agent's replies at each newest checkpoint: to `values`, and to `cycles` per episode."""
    found = [results.checkpoint(trial.spec.id) for trial in setting.trials]
    saved = [(after, checkpoint.agent) for after, checkpoint in filter(None, found)]
    values, cycles = [], []
    if saved:
        with local(
            build(find(Role.AGENT, agent.name), agent.options),
            build(find(Role.ENVIRONMENT, environment.name), environment.options),
        ) as glue:
            glue.rl_init()
            for after, learned in saved:
                glue.rl_agent_load(learned)
                answers = [glue.rl_agent_message(question) for question in ("values", "cycles")]
                values += [int(answer) for answer in answers[:1] if answer.isdecimal()]
                cycles += [int(answer) / after for answer in answers[1:] if answer.isdecimal()]
    return tuple(values), tuple(cycles)


def _ascending(episodes: Iterable[int | None]) -> list[int]:
    return sorted(episode for episode in episodes if episode is not None)
