"""Run the unfinished trials of a plan: in this process, in workers on this machine, or on a Ray cluster."""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass, field

from experiment_runner.executors.dispatch import Dispatcher, Executor
from experiment_runner.executors.job import Job
from experiment_runner.executors.local import LocalExecutor
from experiment_runner.executors.ray_cluster import RayExecutor, parse_address
from experiment_runner.executors.resume import remaining
from experiment_runner.executors.settings import CHECKPOINT_EVERY, Place
from experiment_runner.executors.trial import Start
from experiment_runner.interrupts import GRACE_SECONDS, Interrupts
from experiment_runner.plan import Plan, TrialSpec, class_files
from experiment_runner.players import HubOptions, Meeting
from experiment_runner.report.progress import Reporter
from experiment_runner.store.store import Store
from glue.core.config import DEFAULT_SESSION
from glue.errors import ConfigError
from glue.trajectory import TrajectoryWriter

__all__ = ["RunConfig", "run_trials"]


@dataclass(frozen=True, slots=True)
class RunConfig:
    """How a run is executed. None of this affects the results.

    Args:
        meeting: how the players of each trial are connected.
        checkpoint_every: episodes between checkpoints; 0 for none.
        place: where trials run.
        workers: maximum number of concurrent trials, each in its own process. None for one after the other
            in this process, or for the number of processors of a cluster.
        address: address of the Ray cluster; None for the one that Ray finds, or one on this machine.
        questions: messages that the agent is sent after each episode, and each recorded step.
    """

    meeting: Meeting = field(default_factory=Meeting)
    checkpoint_every: int = CHECKPOINT_EVERY
    place: Place = Place.LOCAL
    workers: int | None = None
    address: str | None = None
    questions: tuple[str, ...] = ()

    def check(self, plan: Plan, recording: bool = False) -> None:
        """Check that `plan` can be executed like this, and recorded if `recording` is true.

        Raises:
            ConfigError: it cannot.
        """
        if self.address is not None:
            if self.place is not Place.RAY:
                raise ConfigError("--address is the address of a Ray cluster: add --engine ray")
            parse_address(self.address)
        parallel = self.place is Place.RAY or self.workers is not None
        if (parallel or self.meeting.in_process) and self.meeting.hub != HubOptions():
            why = "every worker starts its own hub" if parallel else "with --in-process there is no hub"
            raise ConfigError(f"{why}: leave out --hub, --bind, --session and --legacy-port")
        if parallel or self.meeting.in_process:
            for role, sweeps in (("agent", plan.agents), ("env", plan.environments)):
                if not sweeps:
                    raise ConfigError(
                        f"--{role} NAME is missing: a player can join from outside only where trials run "
                        "one after the other, over a hub"
                    )
        if recording and parallel:
            raise ConfigError("--record needs a trial in this process: leave out --workers and --engine ray")
        if recording and (count := len(plan.expand())) > 1:
            raise ConfigError(f"--record needs a single trial, and the plan has {count}: make a plan of one")


def run_trials(
    store: Store, config: RunConfig, reporter: Reporter, recording: TrajectoryWriter | None = None
) -> int:
    """Run the unfinished trials of a run; return how many of all trials have failed.

    A failure is recorded with its reason, and the other trials continue. After Ctrl-C, running episodes have
    half a second to end, and are stored with a checkpoint.

    Args:
        store: the store of the run.
        config: how it is executed.
        reporter: shows progress.
        recording: receives every step, if `config` was checked for that; None for no recording.

    Raises:
        StorageError: the store cannot be written to.
        ExperimentError: the workers or the cluster cannot be started.
        KeyboardInterrupt: on Ctrl-C or SIGTERM.
    """

    def make_job(spec: TrialSpec, start: Start) -> Job:
        return Job(spec, config.meeting, start, config.checkpoint_every, config.questions)

    reporter.start(store.trials())
    executor = _executor(config)
    try:
        # Workers defer Ctrl-C themselves, so wait a little longer for their reports.
        with Interrupts(GRACE_SECONDS if executor is None else GRACE_SECONDS + 0.3) as interrupts:
            dispatcher = Dispatcher(store, reporter, make_job, interrupts)
            if executor is None:
                dispatcher.run_here(remaining(store), recording)
            else:
                dispatcher.run_on(executor, remaining(store))
    except KeyboardInterrupt:
        if sys.stderr.isatty():
            reporter.say("")  # after the terminal's ^C
        if again := sum(trial.dropped for trial in remaining(store)):
            have = "1 episode has" if again == 1 else f"{again} episodes have"
            reporter.say(f"{have} no checkpoint after them, and will be run again")
        flags = shlex.join(_flags(store, config))
        reporter.say(
            f"go on with: glue-experiment --resume {shlex.quote(str(store.directory))} {flags}".rstrip()
        )
        raise
    finally:
        reporter.close()
    return sum(trial.failure is not None for trial in store.trials())


def _flags(store: Store, config: RunConfig) -> list[str]:
    """Return the options that the run needs again: where players from outside join, what is accepted, and
    what the agent is asked."""
    hub = config.meeting.hub
    flags = [f"--bind={url}" for url in hub.bind]
    flags += [f"--legacy-port={port.host}:{port.port or '*'}={port.session}" for port in hub.legacy]
    for option, value in (("hub", hub.hub), ("key", hub.key), ("hub-key", hub.hub_key), ("keys", hub.keys)):
        if value is not None:
            flags.append(f"--{option}={value}")
    if hub.session != DEFAULT_SESSION:
        flags.append(f"--session={hub.session}")
    if hub.insecure:
        flags.append("--insecure")
    if config.meeting.any_reward:
        flags.append("--any-reward")
    flags += [f"--ask={question}" for question in config.questions]
    if class_files([role for trial in store.trials() for role in (trial.spec.agent, trial.spec.environment)]):
        flags.append("--trust")
    return flags


def _executor(config: RunConfig) -> Executor | None:
    if config.place is Place.RAY:
        return RayExecutor(config.address, config.workers)
    return None if config.workers is None else LocalExecutor(config.workers)
