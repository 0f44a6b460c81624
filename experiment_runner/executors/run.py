"""Run the unfinished trials of a plan: in this process, in workers on this machine, or on a Ray cluster."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field

from experiment_runner.executors.dispatcher import Dispatcher, Executor
from experiment_runner.executors.interrupts import GRACE_SECONDS, Interrupts
from experiment_runner.executors.job import Job, Report
from experiment_runner.executors.opening import remaining
from experiment_runner.executors.players import Placement
from experiment_runner.executors.ray_cluster import RayExecutor
from experiment_runner.executors.settings import CHECKPOINT_EVERY, Backend
from experiment_runner.executors.trial import Start
from experiment_runner.executors.trials import Trials
from experiment_runner.executors.workers import LocalExecutor
from experiment_runner.plan.metrics import MetricsPlan
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.report.progress import Reporter
from experiment_runner.store.store import Store
from glue.trajectory import TrajectoryWriter


@dataclass(frozen=True, slots=True)
class RunConfig:
    """Settings of the execution of a run, which do not affect its results.

    Args:
        placement: the way in which the players of each trial are connected.
        checkpoint_every: number of episodes between checkpoints; 0 for none.
        backend: the kind of machine on which trials run.
        workers: maximum number of concurrent trials, each in its own process, or of a job array's tasks. None
            for one trial at a time in this process, one for each processor of a cluster, or no limit.
        address: address of the Ray cluster; None for the one that Ray finds, or one on this machine.
        questions: messages to send to the agent after each episode, and each recorded step.
        metrics: the agents' metrics to record; None for none.
    """

    placement: Placement = field(default_factory=Placement)
    checkpoint_every: int = CHECKPOINT_EVERY
    backend: Backend = Backend.LOCAL
    workers: int | None = None
    address: str | None = None
    questions: tuple[str, ...] = ()
    metrics: MetricsPlan | None = None

    @property
    def parallel(self) -> bool:
        """Whether trials run in processes of their own, at the same time."""
        return self.backend is not Backend.LOCAL or self.workers is not None


def run_trials(
    store: Store,
    config: RunConfig,
    reporter: Reporter,
    recording: TrajectoryWriter | None = None,
    *,
    again: str = "",
) -> int:
    """Run the unfinished trials of a run; return the number of all its trials that have failed.

    A failure is recorded with its reason, and the other trials continue. After Ctrl-C, running episodes have
    half a second to end, and are stored with a checkpoint.

    Args:
        store: the store of the run.
        config: the settings of its execution.
        reporter: shows progress.
        recording: receives every step, if this process runs a single trial; None for no recording.
        again: command that continues the run, shown after an interruption; empty for none.

    Raises:
        StorageError: the store cannot be written to.
        ExperimentError: the workers or the cluster cannot be started.
        KeyboardInterrupt: on Ctrl-C or SIGTERM.
    """

    def make_job(spec: TrialSpec, start: Start) -> Job:
        return Job(spec, config.placement, start, config.checkpoint_every, config.questions, config.metrics)

    reporter.start(store.trials())
    executor = _executor(config)
    try:
        # Workers defer Ctrl-C themselves, so wait a little longer for their reports.
        grace = GRACE_SECONDS if executor is None else GRACE_SECONDS + 0.3
        trial_ids = [trial.trial_id for trial in remaining(store)]
        with Trials(store, reporter, make_job) as trials, Interrupts(grace) as interrupts:
            if executor is None:
                trials.run_here(trial_ids, interrupts, recording)
            else:
                Dispatcher(executor, trials, interrupts).run(trial_ids)
    except KeyboardInterrupt:
        if sys.stderr.isatty():
            reporter.say("")  # after the terminal's ^C
        if dropped := sum(trial.dropped for trial in remaining(store)):
            have = "1 episode has" if dropped == 1 else f"{dropped} episodes have"
            reporter.say(f"{have} no checkpoint after them, and will be run again")
        if again:
            reporter.say(f"continue with: {again}")
        raise
    finally:
        reporter.close()
    return sum(trial.failure is not None for trial in store.trials())


def _executor(config: RunConfig) -> Executor[Job, Report] | None:
    if config.backend is Backend.RAY:
        return RayExecutor(config.address, config.workers)
    return None if config.workers is None else LocalExecutor(config.workers)
