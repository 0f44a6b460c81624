"""Play recorded actions again.

An entry point in the group `glue.replays` may name a faster replay for an environment; any other is played
through its `env_step`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, Protocol

import numpy as np
import numpy.typing as npt

from experiment_runner.executors.recording import run_of
from experiment_runner.plan.plan import TrialSpec
from glue.engine.engine import role_seed
from glue.installed import entry_points
from glue.options import build
from glue.plugins.loading import find
from glue.roles import Environment, SeedableEnvironment, offers
from glue.taskspec import parse_task_spec
from glue.trajectory import Run
from glue.types import Action, step_of
from glue.wire.messages import Role

_PASSIVE_STEPS: Final = 10_000
"""Steps after which a passive agent's episode is cut off, if only the number of episodes limits the task."""

_AT_ONCE: Final = 1_000
"""Passive steps per call."""


def recorded_run(spec: TrialSpec, task_spec: str) -> Run:
    """Return the run that the record of a trial begins with.

    It tells the name of a file that the environment reads, and its digest, not where the organiser keeps it.
    """
    run = run_of(spec, task_spec)
    named = {name for name in run.options if f"{name}_digest" in run.options}
    options = {name: Path(str(one)).name if name in named else one for name, one in run.options.items()}
    return replace(run, options=options)


def made_for(spec: TrialSpec) -> Environment:
    """Return the environment of a trial, seeded if it can be.

    Raises:
        ConfigError: there is no such environment, or it lacks one of the options.
    """
    assert spec.environment is not None
    environment: Environment = build(find(Role.ENVIRONMENT, spec.environment.name), spec.environment.options)
    if offers(environment, SeedableEnvironment):
        environment.env_seed(role_seed(spec.seed, Role.ENVIRONMENT))
    return environment


class Replay(Protocol):
    """Plays episodes of one environment without an agent."""

    def start(self) -> None:
        """Begin an episode."""
        ...

    def play(
        self, actions: Sequence[Action], choices: npt.NDArray[np.int64]
    ) -> tuple[npt.NDArray[np.float64], bool]:
        """Carry out actions until the episode ends; return their rewards, and whether it ended.

        Args:
            actions: the different actions.
            choices: indices of the actions to carry out, shape (N,).
        """
        ...


def replay_of(spec: TrialSpec) -> tuple[Replay, str]:
    """Return a replay of a trial's environment, from its beginning, and the environment's task spec.

    Raises:
        ConfigError: the environment no longer exists, or lacks one of the options.
    """
    environment = made_for(spec)
    task_spec = environment.env_init()
    assert spec.environment is not None
    for point in entry_points("glue.replays").select(name=spec.environment.name):
        compiled: Replay = point.load()(environment)
        return compiled, task_spec
    return _StepByStep(environment), task_spec


class _StepByStep:
    def __init__(self, environment: Environment) -> None:
        self._environment = environment

    def start(self) -> None:
        self._environment.env_start()

    def play(
        self, actions: Sequence[Action], choices: npt.NDArray[np.int64]
    ) -> tuple[npt.NDArray[np.float64], bool]:
        rewards = np.empty(len(choices))
        for i, choice in enumerate(choices.tolist()):
            step = step_of(self._environment.env_step(actions[choice]))
            rewards[i] = step.reward
            if step.terminal:
                return rewards[: i + 1], True
        return rewards, False


def passive_score(spec: TrialSpec, steps: int) -> float:
    """Return the sum of rewards that a passive agent earns in a trial.

    Its only action is zero in every dimension, or the nearest legal number.

    Args:
        spec: the trial.
        steps: number of steps; 0 if the number of episodes counts.

    Raises:
        TaskSpecError: the task spec does not parse.
    """
    replay, task_spec = replay_of(spec)
    action = [Action(*parse_task_spec(task_spec).actions.still())]
    total, left, episodes = 0.0, steps, 0
    while left > 0 if steps else episodes < spec.episodes:
        replay.start()
        room, ended = left if steps else _PASSIVE_STEPS, False
        while room > 0 and not ended:
            rewards, ended = replay.play(action, np.zeros(min(room, _AT_ONCE), np.int64))
            room -= len(rewards)
            left -= len(rewards)
            for reward in rewards.tolist():
                total += reward
        episodes += 1
    return total
