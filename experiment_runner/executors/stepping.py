"""An episode of a trial step by step, and the agent's metrics and the reward during it."""

from __future__ import annotations

from collections.abc import Callable

from experiment_runner.plan.metrics import ALL, MetricsPlan
from experiment_runner.store.records import TOTAL_REWARD, EpisodeResult, Reading
from glue.engine.experiment import Experiment
from glue.errors import GlueError, Unsupported
from glue.types import Action, Observation, Step


def play_steps(
    glue: Experiment,
    max_steps: int,
    started: Callable[[Observation], None],
    stepped: Callable[[Action, Step], None],
) -> bool:
    """Run an episode as `Experiment.rl_episode`, one step at a time.

    Args:
        glue: the experiment.
        max_steps: step limit of RL_episode.
        started: called with the first observation.
        stepped: called after each step with the action and its result.
    """
    observation, action = glue.rl_start()
    started(observation)
    num_steps = 1
    while max_steps == 0 or num_steps < max_steps:
        step = glue.rl_step()
        stepped(action, step)
        if step.terminal:
            return not step.truncated
        action = step.action
        num_steps += 1
    return False


class Meter:
    """Reader of an agent's metrics in a trial and, if they are read during episodes, of the total reward.

    Args:
        glue: the experiment.
        plan: the readings to be taken.
        steps, reward: sums over the episodes before the first.
    """

    def __init__(self, glue: Experiment, plan: MetricsPlan, steps: int, reward: float) -> None:
        self._glue = glue
        self._plan = plan
        self._steps = steps
        self._reward = reward
        self._in_episode = 0, 0.0  # steps and reward of the episode under way
        self._readings: list[Reading] = []
        self._offered = True

    @property
    def each_step(self) -> bool:
        """Whether it has to be told of each step."""
        return self._plan.every > 0

    def begin(self) -> None:
        """Note that an episode begins; what was read in one that became void is forgotten."""
        self._in_episode = 0, 0.0
        self._readings.clear()

    def step(self, reward: float) -> None:
        """Note a step of the episode, and read the metrics if it is time."""
        steps, before = self._in_episode
        self._in_episode = steps + 1, before + reward
        self._read_after(self._steps + steps + 1)

    def end(self, result: EpisodeResult) -> tuple[Reading, ...]:
        """Note the end of an episode; return its readings."""
        if not self.each_step:
            self._read(result.episode, self._steps + result.steps)
        elif self._in_episode[0] < result.steps:  # the step that the limit cut off
            self._read_after(self._steps + result.steps)
        self._steps += result.steps
        self._reward += result.episode_return
        return tuple(self._readings)

    def _read_after(self, step: int) -> None:
        if step % self._plan.every == 0:
            number = step // self._plan.every
            self._readings.append(Reading(TOTAL_REWARD, number, step, self._reward + self._in_episode[1]))
            self._read(number, step)

    def _read(self, number: int, step: int) -> None:
        if not self._offered:
            return
        try:
            metrics = self._glue.rl_agent_metrics()
        except Unsupported:
            self._offered = False
            return
        if TOTAL_REWARD in metrics:
            raise GlueError(f"the agent has a metric {TOTAL_REWARD!r}, which is the name of the trial's own")
        for name, value in metrics.items():
            keep = self._plan.keep.get(name, ALL)
            if keep.averaged or number % keep.every == 0:
                self._readings.append(Reading(name, number, step, value, keep.every, keep.averaged))
