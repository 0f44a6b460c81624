"""Run what remains of a plan into its store: here, in processes of this machine, or on a Ray cluster."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial

from experiment_runner.executors.distribute import Pool, distribute
from experiment_runner.executors.ray_cluster import RayCluster
from experiment_runner.executors.work import work
from experiment_runner.executors.workers import Workers
from experiment_runner.plan import Plan
from experiment_runner.players import HubOptions, Meeting
from experiment_runner.report.progress import Reporter
from experiment_runner.resume import remaining
from experiment_runner.store.store import Store
from experiment_runner.store.writer import Writer
from glue.errors import ConfigError
from glue.trajectory import TrajectoryWriter

__all__ = ["Engine", "RunConfig", "run_trials"]


class Engine(StrEnum):
    """Where trials run."""

    LOCAL = "local"
    RAY = "ray"


@dataclass(frozen=True, slots=True)
class RunConfig:
    """How a run is carried out. Nothing of it changes a result.

    Args:
        meeting: how the players of each trial meet.
        checkpoint_every: episodes between checkpoints of what the players know; 0 for none.
        engine: where trials run.
        workers: trials at a time, each in a process of its own. None: one after the other in this
            process, or as many as a cluster has processors.
        address: of the Ray cluster; None for the one that Ray finds, or one on this machine.
    """

    meeting: Meeting = field(default_factory=Meeting)
    checkpoint_every: int = 100
    engine: Engine = Engine.LOCAL
    workers: int | None = None
    address: str | None = None

    def check(self, plan: Plan, recording: bool = False) -> None:
        """Check that `plan` can be carried out so, and recorded if it is to be.

        Raises:
            ConfigError: it cannot; the message says why.
        """
        if self.address is not None and self.engine is not Engine.RAY:
            raise ConfigError("--address is that of a Ray cluster: say --engine ray")
        parallel = self.engine is Engine.RAY or self.workers is not None
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

    A trial that fails is recorded, with the reason, and the others go on.

    Args:
        store: of the run.
        config: how it is carried out.
        reporter: is told what happens.
        recording: is written every step, if `config` was checked for that; None for none.

    Raises:
        StorageError: the store cannot be written.
        ExperimentError: workers or cluster cannot be started.
    """
    reporter.start(store.trials())
    writer = Writer(store, reporter, config.meeting, config.checkpoint_every)
    try:
        pool = _pool(config)
        if pool is None:
            for trial in remaining(store):
                work(writer.job(trial), partial(writer.take, trial.trial_id), recording)
        else:
            distribute(remaining(store), pool, writer)
    except KeyboardInterrupt:
        reporter.say(f"interrupted; go on with: glue-experiment --resume {store.directory}")
        raise
    finally:
        reporter.close()
    return sum(trial.failure is not None for trial in store.trials())


def _pool(config: RunConfig) -> Pool | None:
    if config.engine is Engine.RAY:
        return RayCluster(config.address, config.workers)
    return None if config.workers is None else Workers(config.workers)
