"""Run the unfinished trials of a run: in this process, in workers on this machine, or on a Ray cluster."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Collection, Container, Iterable
from functools import partial
from typing import Final

from experiment_runner.executors import job as reports
from experiment_runner.executors.dispatcher import Dispatcher, Executor
from experiment_runner.executors.interrupts import Interrupts
from experiment_runner.executors.opening import go_back, remaining
from experiment_runner.executors.trial import run_job
from experiment_runner.executors.workers import LocalExecutor, RayExecutor
from experiment_runner.plan.limits import Backend
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.report.progress import Progress
from experiment_runner.store.layout import LiveSession, put_live_sessions
from experiment_runner.store.records import OF_PLAYERS, UNSEEDED
from experiment_runner.store.store import Store
from glue.closing import Closing
from glue.trajectory import TrajectoryWriter

_COMMIT_SECONDS: Final = 0.05
"""Seconds after a commit in which episodes are kept for the next one; a crash loses them."""


def run_trials(
    store: Store,
    config: reports.RunConfig,
    reporter: Progress,
    recording: TrajectoryWriter | None = None,
    *,
    again: str = "",
    only: Container[str] | None = None,
) -> int:
    """Run the unfinished trials of a run; return the number of all its trials that have failed.

    A failure is recorded with its reason, and the other trials continue. After Ctrl-C, running episodes have
    `config.grace` seconds to end, and are stored with a checkpoint.

    Args:
        store: the store of the run.
        config: the settings of its execution.
        reporter: shows progress.
        recording: receives every step, if this process runs a single trial; None for no recording.
        again: command that continues the run, shown after an interruption; empty for none.
        only: the ids of the trials to run; None for all.

    Raises:
        StorageError: the store cannot be written to.
        ExperimentError: the workers or the cluster cannot be started.
        KeyboardInterrupt: on Ctrl-C or SIGTERM.
    """
    reporter.start(store.trials())
    executor = _executor(config)
    try:
        # Workers defer Ctrl-C themselves, so wait a little longer for their reports.
        grace = config.grace if executor is None else config.grace + 0.3
        left = [trial.trial_id for trial in remaining(store)]
        trial_ids = [trial_id for trial_id in left if only is None or trial_id in only]
        with RunCollector(store, config, reporter) as collector, Interrupts(grace) as interrupts:
            if executor is None:
                collector.run_here(trial_ids, interrupts, recording)
            else:
                Dispatcher(executor, collector, interrupts).run(trial_ids)
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


def _executor(config: reports.RunConfig) -> Executor | None:
    if config.backend is Backend.RAY:
        return RayExecutor(config.address, config.workers)
    return None if config.workers is None else LocalExecutor(config.workers)


class RunCollector(Closing):
    """Collector that stores the reports of trials, then shows them.

    Only it writes results to the store of a run. Episodes that end within a short time of each other are
    committed together, and then reported: every reported episode is on disk.

    Args:
        store: open for writing.
        config: the settings of the run's execution.
        reporter: shows progress.
    """

    def __init__(self, store: Store, config: reports.RunConfig, reporter: Progress) -> None:
        self._store = store
        self._config = config
        self._reporter = reporter
        self._live: dict[str, LiveSession] = {}
        put_live_sessions(store.directory, {})  # removes the file of a killed process
        self._specs: dict[str, TrialSpec] = {record.spec.id: record.spec for record in store.trials()}
        self._unstored: list[tuple[str, reports.Recorded]] = []
        self._stored_at = -math.inf
        self._said: set[str] = set()  # texts about all trials of a player
        self._joined: dict[tuple[str, str], str] = {}
        """The names of players that joined from outside, by trial and role."""

    def close(self) -> None:
        """Remove the information for observers of trials in progress."""
        put_live_sessions(self._store.directory, {})

    def run_here(
        self, trial_ids: Iterable[str], interrupts: Interrupts, recording: TrajectoryWriter | None = None
    ) -> None:
        """Run trials in this process, one after the other.

        Args:
            trial_ids: the unfinished trials.
            interrupts: lets the running episode end before Ctrl-C takes effect.
            recording: receives every step; None for no recording.

        Raises:
            StorageError: a report cannot be stored.
        """
        for trial_id in trial_ids:
            send = partial(self._take_here, trial_id)
            try:
                run_job(self.start(trial_id), send, interrupts=interrupts, recording=recording)
            finally:
                self._end_live(trial_id)
                self.commit()

    def _take_here(self, trial_id: str, report: reports.Report) -> None:
        if isinstance(report, reports.Ended):
            self.end(trial_id, report.failure)
        else:
            self.take(trial_id, report)
        # A line may come from a thread that watches players; only this thread writes to the store.
        if isinstance(report, reports.Recorded) and time.monotonic() - self._stored_at >= _COMMIT_SECONDS:
            self.commit()

    def may_start(self, trial_id: str, running: Collection[str]) -> bool:
        """Return True: trials are independent."""
        return True

    def start(self, trial_id: str) -> reports.Job:
        """Return the job of a trial, starting from its newest checkpoint."""
        spec = self._specs[trial_id]
        found = self._store.checkpoint(trial_id)
        start = (
            reports.BEGINNING
            if found is None
            else reports.Start(*found, *self._store.sums_until(trial_id, found[0]))
        )
        self._reporter.begin(spec, start.after, start.steps)
        return reports.Job(spec, self._config, start)

    def take(self, trial_id: str, report: reports.Report) -> None:
        """Store a report; an episode without a checkpoint is kept for `commit`."""
        match report:
            case reports.Recorded():
                self._unstored.append((trial_id, report))
                if report.checkpoint is not None:
                    self.commit()
            case reports.AtHub(hub, session):
                self._live[trial_id] = LiveSession(hub, session)
                put_live_sessions(self._store.directory, self._live)
            case reports.Playing(episode, steps):
                self._reporter.playing(self._specs[trial_id], episode, steps)
            case reports.Line(line):
                self._say(trial_id, line)
            case reports.Voided(episode, why):
                self.commit()
                self._store.record_void(trial_id, episode, why)
                self._say(trial_id, f"episode {episode} is void: {why}")
            case reports.Happened(kind, text):
                self._record_event(trial_id, kind, text)
            case reports.Joined(role, name, program, seeded):
                self.commit()
                player = self._store.record_player(trial_id, role, name, program)
                self._joined[trial_id, role] = name
                spec = self._specs[trial_id]
                self._reporter.rename(spec, spec.named(self._joined))
                self._say(trial_id, f"{player} joined")
                line = f"the {player} takes no seed: its random numbers cannot be repeated"
                if not seeded and self._store.record_once(UNSEEDED, line):
                    self._reporter.say(line)

    def commit(self) -> None:
        """Store the episodes that are kept, then report them."""
        unstored, self._unstored = self._unstored, []
        if unstored:
            self._store.record_all([(trial_id, *recorded) for trial_id, recorded in unstored])
            for trial_id, recorded in unstored:
                self._reporter.episode(self._specs[trial_id], recorded.result)
            self._stored_at = time.monotonic()

    def lost(self, trial_id: str, why: str) -> int:
        """Store that a trial was lost; return the number of its episodes that are stored."""
        self._end_live(trial_id)
        self._record_event(trial_id, "lost", why)
        return self._store.done(trial_id)

    def starts_again(self, trial_id: str) -> bool:
        """Prepare a lost trial to continue from its newest checkpoint; return False if it is finished."""
        for trial in remaining(self._store):
            if trial.trial_id == trial_id:
                go_back(self._store, trial)
                self._say(trial_id, f"it {trial.course}")
                return True
        return False

    def end(self, trial_id: str, failure: str | None) -> None:
        """Store that a trial is over, and the reason if it has failed."""
        self._end_live(trial_id)
        self.commit()
        if failure is not None:
            self._store.record_failure(trial_id, failure)
            self._say(trial_id, f"Error: {failure}")
        self._reporter.end(self._specs[trial_id])

    def _end_live(self, trial_id: str) -> None:
        if self._live.pop(trial_id, None) is not None:
            put_live_sessions(self._store.directory, self._live)

    def _record_event(self, trial_id: str, kind: str, text: str) -> None:
        self.commit()
        self._store.record_event(kind, text, trial_id)
        if kind in OF_PLAYERS:
            if text in self._said:
                return
            self._said.add(text)
        self._say(trial_id, text)

    def _say(self, trial_id: str, text: str) -> None:
        name = self._specs[trial_id].named(self._joined)
        for line in text.splitlines():
            self._reporter.say(line if len(self._specs) == 1 else f"{name}: {line}")
