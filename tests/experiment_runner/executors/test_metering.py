"""The readings of metrics during episodes: due at the same steps, however an episode is run."""

from __future__ import annotations

from pathlib import Path

import pytest

from experiment_runner.executors.job import Start
from experiment_runner.executors.recording import Meter
from experiment_runner.plan.limits import TrialId
from experiment_runner.plan.metrics import Keep, MetricsPlan
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.store.records import TOTAL_REWARD, Checkpoint, EpisodeResult, Reading
from glue import Action, Environment, Experiment, ExperimentError, Observation, Step
from glue.engine.local import LocalExperiment
from glue.trajectory import TrajectoryWriter
from tests.experiment_runner.executors.test_trial import play
from tests.players import ScriptedAgent

LENGTHS = (4, 1, 7, 2, 2)


class Counting(ScriptedAgent):
    """Counts its calls."""

    def agent_metrics(self) -> dict[str, float]:
        return {"calls": float(len(self.calls))}


class Varying(Environment):
    """Ends its episodes after `LENGTHS` steps, or cuts them off there; each step has a different reward."""

    def __init__(self, cut_off: bool) -> None:
        self._lengths = iter(LENGTHS)
        self._cut_off = cut_off
        self._left = 0

    def env_init(self) -> str:
        return ""

    def env_start(self) -> Observation:
        self._left = next(self._lengths)
        return Observation()

    def env_step(self, action: Action) -> Step:
        self._left -= 1
        return Step(0.1 * self._left - 0.3, Observation(), not self._left, self._cut_off and not self._left)


class StepByStep(LocalExperiment):
    """Runs episodes step by step, like an experiment at a hub."""

    rl_go_on = Experiment.rl_go_on


@pytest.mark.parametrize("every", [1, 2, 3, 5])
@pytest.mark.parametrize("max_steps", [0, 1, 2, 3, 5])
@pytest.mark.parametrize("cut_off", [False, True])
def test_readings_are_due_at_the_same_steps_however_an_episode_is_run(
    every: int, max_steps: int, cut_off: bool, tmp_path: Path
) -> None:
    spec = TrialSpec(TrialId("t"), None, None, len(LENGTHS), max_steps, 1)
    with TrajectoryWriter(tmp_path / "recording") as writer:
        ways = ((LocalExperiment, None), (StepByStep, None), (LocalExperiment, writer))
        found = [
            play(kind(Counting(), Varying(cut_off)), spec=spec, recording=one, metrics=MetricsPlan(every))
            for kind, one in ways
        ]
    first, *others = ((kept.numbers, kept.readings) for kept in found)
    assert others == [first, first]
    steps = sum(result.steps for result in found[0].results)
    assert [reading.step for reading in found[0].readings] == [*range(every, steps + 1, every)]
    assert all(reading.values.keys() == {TOTAL_REWARD, "calls"} for reading in found[0].readings)


def test_means_continue_from_what_was_saved_within_a_group() -> None:
    plan = MetricsPlan(0, {"calls": Keep(3, averaged=True)})
    glue = LocalExperiment(Counting(), Varying(False))
    glue.rl_init(1)
    whole, saved, calls = Meter(glue, plan), b"", []
    for number in range(1, 4):
        glue.rl_episode()
        calls.append(glue.rl_agent_metrics()["calls"])
        result = EpisodeResult(number, 1.0, 1, True, 0.0)
        resumed = Meter(
            glue, plan, Start(number - 1, Checkpoint(b"", metrics=saved), number - 1, number - 1.0)
        )
        found = []
        for meter in (whole, resumed):
            meter.begin()
            found.append(meter.end(result))
        saved = resumed.save()
        assert found[0] == found[1] == ((Reading(3, {"calls": sum(calls) / 3}),) if number == 3 else ())
        assert saved == whole.save()
    assert saved == b""


def test_means_forget_an_attempt_that_became_void() -> None:
    glue = LocalExperiment(Counting(), Varying(False))
    meter = Meter(glue, MetricsPlan(1, {"calls": Keep(2, averaged=True)}))
    glue.rl_init(1)
    calls = []
    for steps in (1, 2):
        meter.begin()
        glue.rl_start()
        for step in range(1, steps + 1):
            glue.rl_go_on(step + 1)
            calls.append(glue.rl_agent_metrics()["calls"])
            meter.after(step)
        if steps == 1:  # the second episode of the environment ends at once
            glue.rl_episode()
    _, second, _ = meter.end(EpisodeResult(1, 0.0, 3, False, 0.0))
    assert second.values["calls"] == (calls[1] + calls[2]) / 2


def test_what_was_saved_of_metrics_may_be_damaged() -> None:
    glue = LocalExperiment(Counting(), Varying(False))
    with pytest.raises(ExperimentError, match="the metrics of a checkpoint are damaged"):
        Meter(glue, MetricsPlan(0), Start(0, Checkpoint(b"", metrics=b"damaged")))
