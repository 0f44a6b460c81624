"""The readings of an agent's metrics, and of the total reward, in the episodes of a trial."""

from __future__ import annotations

from experiment_runner.plan.metrics import ALL, MetricsPlan
from experiment_runner.store.readings import Part, pack_parts, unpack_parts
from experiment_runner.store.records import TOTAL_REWARD, EpisodeResult, Reading
from glue.engine.experiment import Experiment
from glue.errors import GlueError, Unsupported


def play_metered(glue: Experiment, max_steps: int, meter: Meter) -> bool:
    """Run an episode like `Experiment.rl_episode`, and take the readings that are due during it."""
    glue.rl_start()
    step = 0
    while max_steps == 0 or step + 1 < max_steps:
        step = meter.next_after(step)
        until = step + 1 if max_steps == 0 else min(step + 1, max_steps)  # RL_num_steps is 1 after the start
        terminal = glue.rl_go_on(until)
        reached = until == step + 1 if terminal is None else not terminal and glue.rl_num_steps() == step + 1
        if reached:
            meter.read(step)
        if terminal is not None:
            return terminal
    return False


class Meter:
    """Reader of an agent's metrics in a trial and, if they are read during episodes, of the total reward.

    Args:
        glue: the experiment.
        plan: the readings to take.
        steps, reward: sums over the episodes before the first one here.
        saved: the result of `save` after the last of these episodes; empty if there is none.

    Attributes:
        each_step: whether metrics are read during episodes.
        missing: why there are no metrics; empty unless the agent turned out to have none.

    Raises:
        ExperimentError: `saved` is damaged.
    """

    def __init__(
        self, glue: Experiment, plan: MetricsPlan, steps: int = 0, reward: float = 0.0, saved: bytes = b""
    ) -> None:
        self._glue = glue
        self._plan = plan
        self._steps = steps
        self._reward = reward
        self._before = unpack_parts(saved)  # the parts before the episode under way
        self._parts = dict(self._before)
        self._readings: list[Reading] = []
        self.each_step: bool = plan.every > 0
        self.missing: str = ""

    def begin(self) -> None:
        """Begin an episode; the readings of one that became void are dropped."""
        self._readings = []
        self._parts = dict(self._before)

    def next_after(self, step: int) -> int:
        """Return the next step after `step` with a reading, counted in the episode, whose start is 0."""
        every = self._plan.every
        return step + every - (self._steps + step) % every

    def read(self, step: int) -> None:
        """Read the metrics after a step of the episode."""
        at = self._steps + step
        self._read(at // self._plan.every, at, {TOTAL_REWARD: self._reward + self._glue.rl_return()})

    def end(self, result: EpisodeResult) -> tuple[Reading, ...]:
        """End an episode, with a reading of its last step if one is due; return all of its readings."""
        if not self.each_step:
            self._read(result.episode, self._steps + result.steps, {})
        elif self.next_after(result.steps - 1) == result.steps:
            self.read(result.steps)
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
