"""Dispatch jobs to an executor, store their reports, and restart lost jobs.

Only this module writes results to the store of a run. Episodes that end within a moment of each other are
committed together, and reported after that: what was reported is on disk.
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterable
from contextlib import closing
from functools import partial
from types import TracebackType
from typing import Final, Protocol, Self

from experiment_runner.executors.job import (
    Ended,
    Happened,
    Job,
    Lost,
    Met,
    Recorded,
    Report,
    Said,
    Voided,
    run_job,
)
from experiment_runner.executors.resume import Remaining, go_back, remaining
from experiment_runner.executors.trial import BEGINNING, Start
from experiment_runner.interrupts import Interrupts
from experiment_runner.plan import TrialSpec
from experiment_runner.report.progress import Reporter
from experiment_runner.store.joined import joined_player, trial_name
from experiment_runner.store.meetings import Meetings, Place
from experiment_runner.store.store import Store
from glue.trajectory import TrajectoryWriter

__all__ = ["Dispatcher", "Executor"]

_MAX_LOSSES: Final = 3
_WAIT_SECONDS: Final = 0.1
_COMMIT_SECONDS: Final = 0.05
"""How long after a commit episodes are kept for the next one: as much work is lost with the process."""


class Executor(Protocol):
    """Runs trials somewhere. Leaving its context ends them all.

    Attributes:
        size: maximum number of concurrent trials.
    """

    size: int

    def start(self, job: Job) -> None:
        """Start a trial. It is over when `receive` returns `Ended` or `Lost` for it."""
        ...

    def receive(self, seconds: float) -> list[tuple[str, Report]]:
        """Return reports with the ids of their trials, in order for each trial; wait at most `seconds`."""
        ...

    def stop(self) -> None:
        """Ask all trials to end soon: the run is interrupted."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


class Dispatcher:
    """Stores what trials report, then passes it to the reporter.

    Args:
        store: open for writing.
        reporter: shows progress.
        make_job: returns the job for a trial and its starting point.
        interrupts: lets running episodes end before Ctrl-C takes effect.
    """

    def __init__(
        self,
        store: Store,
        reporter: Reporter,
        make_job: Callable[[TrialSpec, Start], Job],
        interrupts: Interrupts,
    ) -> None:
        self._store = store
        self._reporter = reporter
        self._make_job = make_job
        self._interrupts = interrupts
        self._meetings = Meetings(store.directory)
        self._specs = {record.spec.id: record.spec for record in store.trials()}
        self._unstored: list[tuple[str, Recorded]] = []
        self._stored_at = -math.inf
        self._losses: dict[str, tuple[int, int]] = {}
        """For each lost trial: its progress, and how often it was lost without further progress."""
        self._joined: dict[tuple[str, str], str] = {}
        """Names of players from outside, by trial and role."""

    def run_here(self, trials: Iterable[Remaining], recording: TrajectoryWriter | None = None) -> None:
        """Run trials in this process, one after the other.

        Args:
            trials: the unfinished trials.
            recording: receives every step; None for no recording.

        Raises:
            StorageError: a report cannot be stored.
        """
        for trial in trials:
            send = partial(self._take_here, trial.trial_id)
            try:
                run_job(self._job(trial), send, interrupts=self._interrupts, recording=recording)
            finally:
                self._meetings.end(trial.trial_id)
                self._store_episodes()

    def _take_here(self, trial_id: str, report: Report) -> None:
        self.take(trial_id, report)
        # A line may come from a thread that watches players; this thread alone writes to the store.
        if isinstance(report, Recorded) and time.monotonic() - self._stored_at >= _COMMIT_SECONDS:
            self._store_episodes()

    def run_on(self, executor: Executor, trials: Iterable[Remaining]) -> None:
        """Run trials on an executor.

        A lost trial continues from its newest checkpoint; lost three times in a row without progress, it has
        failed.

        Raises:
            StorageError: a report cannot be stored.
            ExperimentError: the executor cannot run anything.
        """
        with closing(self._meetings), executor, self._interrupts.deferred():
            waiting = deque(trials)
            running: set[str] = set()
            stopped = False
            while running or (waiting and not stopped):
                while waiting and len(running) < executor.size and not stopped:
                    job = self._job(waiting.popleft())
                    running.add(job.spec.id)
                    executor.start(job)
                for trial_id, report in executor.receive(_WAIT_SECONDS):
                    if isinstance(report, (Ended, Lost)):
                        running.remove(trial_id)
                    if stopped and isinstance(report, Lost):
                        continue  # it was asked to stop
                    self.take(trial_id, report)
                    if isinstance(report, Lost):
                        waiting.extendleft(self._after_loss(trial_id, report))
                self._store_episodes()
                if self._interrupts.requested and not stopped:
                    stopped = True
                    executor.stop()

    def take(self, trial_id: str, report: Report) -> None:
        """Store a report; an episode with no checkpoint after it together with those that end soon.

        Raises:
            StorageError: it cannot be stored.
        """
        store, reporter, spec = self._store, self._reporter, self._specs[trial_id]
        if isinstance(report, Recorded):
            self._unstored.append((trial_id, report))
            if report.checkpoint is not None:
                self._store_episodes()
            return
        if isinstance(report, Met):
            self._meetings.begin(trial_id, Place(report.hub, report.session))
            return
        if isinstance(report, (Ended, Lost)):
            self._meetings.end(trial_id)
        if isinstance(report, Said):
            self._say(trial_id, report.line)
            return
        self._store_episodes()
        match report:
            case Voided(episode, why):
                store.record_void(trial_id, episode, why)
                self._say(trial_id, f"episode {episode} is void: {why}")
            case Happened(kind, text):
                store.record_event(kind, text, trial_id)
                if kind == "joined":
                    self._note_player(spec, text)
                self._say(trial_id, text)
            case Lost(why):
                store.record_event("lost", why, trial_id)
                self._say(trial_id, why)
            case Ended(failure):
                if failure is not None:
                    store.record_failure(trial_id, failure)
                    self._say(trial_id, f"Error: {failure}")
                reporter.end(spec)

    def _store_episodes(self) -> None:
        """Commit the episodes that are kept, then report them."""
        unstored, self._unstored = self._unstored, []
        if unstored:
            self._store.record_all([(trial_id, *recorded) for trial_id, recorded in unstored])
            for trial_id, recorded in unstored:
                self._reporter.episode(self._specs[trial_id], recorded.result)
            self._stored_at = time.monotonic()

    def _job(self, trial: Remaining) -> Job:
        spec = self._specs[trial.trial_id]
        self._reporter.begin(spec, trial.after)
        found = self._store.checkpoint(spec.id) if trial.after else None
        return self._make_job(spec, Start(*found) if found else BEGINNING)

    def _after_loss(self, trial_id: str, loss: Lost) -> list[Remaining]:
        """Return what remains of a lost trial, prepared to continue."""
        done = self._store.done(trial_id)
        furthest, count = self._losses.get(trial_id, (-1, 0))
        count = 1 if done > furthest else count + 1
        if count == _MAX_LOSSES:
            why = f"{loss.why}, {count} times without getting past episode {furthest}"
            self.take(trial_id, Ended(why))
            return []
        self._losses[trial_id] = (max(done, furthest), count)
        left = [trial for trial in remaining(self._store) if trial.trial_id == trial_id]
        for trial in left:
            go_back(self._store, trial)
            self._say(trial_id, f"it {trial.course}")
        if not left:
            self.take(trial_id, Ended(None))
        return left

    def _note_player(self, spec: TrialSpec, text: str) -> None:
        player = joined_player(text)
        if player is not None:
            role, name = player
            self._joined[spec.id, role] = name
            self._reporter.rename(spec, trial_name(spec, self._joined))

    def _say(self, trial_id: str, text: str) -> None:
        name = trial_name(self._specs[trial_id], self._joined)
        for line in text.splitlines():
            self._reporter.say(line if len(self._specs) == 1 else f"{name}: {line}")
