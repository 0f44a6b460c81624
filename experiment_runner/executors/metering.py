"""The readings of an agent's metrics, and of the total reward, in the episodes of a trial."""

from __future__ import annotations

from experiment_runner.executors.job import BEGINNING, Start
from experiment_runner.plan.metrics import ALL, MetricsPlan
from experiment_runner.store.readings import Part, pack_parts, unpack_parts
from experiment_runner.store.records import TOTAL_REWARD, EpisodeResult, Reading
from glue.engine.experiment import Experiment
from glue.errors import GlueError, Unsupported


class Meter:
    """Reader of an agent's metrics in a trial and, if they are read during episodes, of the total reward.

    Args:
        glue: the experiment.
        plan: the readings to take.
        start: of the trial.

    Attributes:
        each_step: whether metrics are read during episodes.
        missing: why there are no metrics; empty unless the agent turned out to have none.

    Raises:
        ExperimentError: the metrics of its checkpoint are damaged.
    """

    def __init__(self, glue: Experiment, plan: MetricsPlan, start: Start = BEGINNING) -> None:
        self._glue = glue
        self._plan = plan
        self._steps = start.steps
        self._reward = start.reward
        saved = start.checkpoint.metrics if start.checkpoint else b""
        self._before = unpack_parts(saved)  # the parts before the episode under way
        self._parts = dict(self._before)
        self._readings: list[Reading] = []
        self.each_step: bool = plan.every > 0
        self.missing: str = ""

    def begin(self) -> None:
        """Begin an episode; the readings of one that became void are dropped."""
        self._readings = []
        self._parts = dict(self._before)

    def rl_episode(self, max_steps: int) -> bool:
        """Run an episode like `Experiment.rl_episode`, with the readings that are due during it."""
        self._glue.rl_start()
        step, terminal = 0, None
        while terminal is None and (max_steps == 0 or step + 1 < max_steps):
            step += self._plan.every - (self._steps + step) % self._plan.every
            # RL_num_steps is 1 after the start, and stays as it is at the end of the episode.
            terminal = self._glue.rl_go_on(min(step + 1, max_steps or step + 1))
            if not terminal and self._glue.rl_num_steps() == step + 1:
                self.after(step)
        return bool(terminal)

    def after(self, step: int) -> None:
        """Read the metrics after a step of the episode, counted from 1, if they are due."""
        at = self._steps + step
        if at % self._plan.every == 0:
            self._read(at // self._plan.every, at, {TOTAL_REWARD: self._reward + self._glue.rl_return()})

    def end(self, result: EpisodeResult) -> tuple[Reading, ...]:
        """End an episode, with a reading of its last step if one is due; return all of its readings."""
        if not self.each_step:
            self._read(result.episode, self._steps + result.steps, {})
        else:
            self.after(result.steps)
        self._steps += result.steps
        self._reward += result.episode_return
        self._before = self._parts
        return tuple(self._readings)

    def save(self) -> bytes:
        """Return the unfinished means after an episode, on which later readings depend."""
        return pack_parts(self._before)

    def _read(self, number: int, step: int, own: dict[str, float]) -> None:
        """Read the metrics for the `number`-th time, counted from 1, and add the trial's own."""
        try:
            metrics = {} if self.missing else self._glue.rl_agent_metrics()
        except Unsupported as error:
            metrics, self.missing = {}, str(error)
        if TOTAL_REWARD in metrics:
            raise GlueError(f"the agent has a metric {TOTAL_REWARD!r}, which is the name of the trial's own")
        if self._plan.keep:
            metrics = self._kept(number, metrics)
        if own or metrics:
            self._readings.append(Reading(step, {**own, **metrics} if own else metrics))

    def _kept(self, number: int, metrics: dict[str, float]) -> dict[str, float]:
        """Return the values to keep, or means in their place."""
        kept = {}
        for name, value in metrics.items():
            every, averaged = self._plan.keep.get(name, ALL)
            if averaged:
                group = (number - 1) // every
                part = self._parts.get(name)
                total, count = (part.total, part.members) if part and part.group == group else (0.0, 0)
                self._parts[name] = Part(group, total + value, count + 1)
                value = (total + value) / (count + 1)
            if number % every == 0:
                self._parts.pop(name, None)
                kept[name] = value
        return kept
