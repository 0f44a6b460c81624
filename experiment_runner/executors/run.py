"""Run what remains of a plan into its store: here, in processes of this machine, or on a Ray cluster."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

from experiment_runner.executors.dispatch import Dispatcher, Executor
from experiment_runner.executors.job import Job
from experiment_runner.executors.local import LocalExecutor
from experiment_runner.executors.ray_cluster import RayExecutor, parse_address
from experiment_runner.executors.resume import remaining
from experiment_runner.executors.trial import Start
from experiment_runner.interrupts import GRACE_SECONDS, Interrupts
from experiment_runner.plan import Plan, TrialSpec, class_files
from experiment_runner.players import HubOptions, Meeting
from experiment_runner.report.progress import Reporter
from experiment_runner.store.store import Store
from glue.errors import ConfigError
from glue.trajectory import TrajectoryWriter

__all__ = ["Place", "RunConfig", "run_trials"]


class Place(StrEnum):
    """Where trials run: on this machine, or on a Ray cluster."""

    LOCAL = "local"
    RAY = "ray"


@dataclass(frozen=True, slots=True)
class RunConfig:
    """How a run is carried out. Nothing of it changes a result.

    Args:
        meeting: how the players of each trial meet.
        checkpoint_every: episodes between checkpoints of what the players have learned; 0 for none.
        place: where trials run.
        workers: trials at a time, each in a process of its own. None: one after the other in this
            process, or as many as a cluster has processors.
        address: of the Ray cluster; None for the one that Ray finds, or one on this machine.
    """

    meeting: Meeting = field(default_factory=Meeting)
    checkpoint_every: int = 100
    place: Place = Place.LOCAL
    workers: int | None = None
    address: str | None = None

    def check(self, plan: Plan, recording: bool = False) -> None:
        """Check that `plan` can be carried out so, and recorded if it is to be.

        Raises:
            ConfigError: it cannot; the message says why.
        """
        if self.address is not None:
            if self.place is not Place.RAY:
                raise ConfigError("--address is that of a Ray cluster: say --engine ray")
            parse_address(self.address)
        parallel = self.place is Place.RAY or self.workers is not None
        if (parallel or self.meeting.in_process) and self.meeting.hub != HubOptions():
            why = "every worker brings its own hub" if parallel else "with --in-process there is no hub"
            raise ConfigError(f"{why}: leave out --hub, --bind, --session and --legacy-port")
        if parallel or self.meeting.in_process:
            for role, sweeps in (("agent", plan.agents), ("env", plan.environments)):
                if not sweeps:
                    raise ConfigError(
                        f"--{role} NAME is missing: a player can join from outside only where trials run "
                        "one after the other, over a hub"
                    )
        if recording and parallel:
            raise ConfigError("--record is for a trial of this process: leave out --workers and --engine ray")
        if recording and (count := len(plan.expand())) > 1:
            raise ConfigError(f"--record is for a single trial, and the plan has {count}: run one by itself")


def run_trials(
    store: Store, config: RunConfig, reporter: Reporter, recording: TrajectoryWriter | None = None
) -> int:
    """Run what remains of a run; return how many of its trials have failed.

    A trial that fails is recorded, with the reason, and the others go on. After Ctrl-C the episodes under
    way may end, for half a second, and are stored with a checkpoint.

    Args:
        store: of the run.
        config: how it is carried out.
        reporter: shows what happens.
        recording: is written every step, if `config` was checked for that; None for none.

    Raises:
        StorageError: the store cannot be written.
        ExperimentError: workers or cluster cannot be started.
        KeyboardInterrupt: Ctrl-C, or SIGTERM.
    """

    def make_job(spec: TrialSpec, start: Start) -> Job:
        return Job(spec, config.meeting, start, config.checkpoint_every)

    reporter.start(store.trials())
    executor = _executor(config)
    try:
        # Workers defer Ctrl-C themselves; so their reports are waited for a little longer.
        with Interrupts(GRACE_SECONDS if executor is None else GRACE_SECONDS + 0.3) as interrupts:
            dispatcher = Dispatcher(store, reporter, make_job, interrupts)
            if executor is None:
                dispatcher.run_here(remaining(store), recording)
            else:
                dispatcher.run_on(executor, remaining(store))
    except KeyboardInterrupt:
        if again := sum(trial.dropped for trial in remaining(store)):
            reporter.say(f"{again} episodes have no checkpoint after them, and will be run again")
        roles = [role for trial in store.trials() for role in (trial.spec.agent, trial.spec.environment)]
        trust = " --trust" if class_files(roles) else ""
        reporter.say(f"go on with: glue-experiment --resume {store.directory}{trust}")
        raise
    finally:
        reporter.close()
    return sum(trial.failure is not None for trial in store.trials())


def _executor(config: RunConfig) -> Executor | None:
    if config.place is Place.RAY:
        return RayExecutor(config.address, config.workers)
    return None if config.workers is None else LocalExecutor(config.workers)
