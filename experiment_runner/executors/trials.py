"""The trials of an experiment as jobs: their reports are stored, and then shown.

Only this module writes results to the store of a run. Episodes that end within a short time of each other are
committed together, and then reported: every reported episode is on disk.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Iterable
from functools import partial
from typing import Final

from experiment_runner.executors.interrupts import Interrupts
from experiment_runner.executors.job import (
    Ended,
    Happened,
    Job,
    Joined,
    Met,
    Playing,
    Recorded,
    Report,
    Said,
    Voided,
    run_job,
)
from experiment_runner.executors.opening import go_back, remaining
from experiment_runner.executors.trial import BEGINNING, Start
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.report.progress import Reporter
from experiment_runner.store.meetings import LiveSession, Meetings
from experiment_runner.store.records import OF_PLAYERS, UNSEEDED
from experiment_runner.store.store import Store
from glue.closing import Closing
from glue.trajectory import TrajectoryWriter

_COMMIT_SECONDS: Final = 0.05
"""Seconds after a commit in which episodes are kept for the next one; a crash loses them."""


class Trials(Closing):
    """Collector that stores the reports of trials; see `experiment_runner.executors.dispatcher.Collector`.

    Args:
        store: open for writing.
        reporter: shows progress.
        make_job: returns the job for a trial and its starting point.
    """

    def __init__(self, store: Store, reporter: Reporter, make_job: Callable[[TrialSpec, Start], Job]) -> None:
        self._store = store
        self._reporter = reporter
        self._make_job = make_job
        self._meetings = Meetings(store.directory)
        self._specs: dict[str, TrialSpec] = {record.spec.id: record.spec for record in store.trials()}
        self._unstored: list[tuple[str, Recorded]] = []
        self._stored_at = -math.inf
        self._said: set[str] = set()  # texts about all trials of a player
        self._joined: dict[tuple[str, str], str] = {}
        """The names of players that joined from outside, by trial and role."""

    def close(self) -> None:
        """Remove the information for observers of trials in progress."""
        self._meetings.close()

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
                self._meetings.end(trial_id)
                self.commit()

    def _take_here(self, trial_id: str, report: Report) -> None:
        if isinstance(report, Ended):
            self.end(trial_id, report.failure)
        else:
            self.take(trial_id, report)
        # A line may come from a thread that watches players; only this thread writes to the store.
        if isinstance(report, Recorded) and time.monotonic() - self._stored_at >= _COMMIT_SECONDS:
            self.commit()

    def may_start(self, trial_id: str, running: Collection[str]) -> bool:
        """Return True: trials are independent."""
        return True

    def start(self, trial_id: str) -> Job:
        """Return the job of a trial, starting from its newest checkpoint."""
        spec = self._specs[trial_id]
        start = self._start(trial_id)
        self._reporter.begin(spec, start.after, start.steps)
        return self._make_job(spec, start)

    def _start(self, trial_id: str) -> Start:
        found = self._store.checkpoint(trial_id)
        return BEGINNING if found is None else Start(*found, *self._store.sums_until(trial_id, found[0]))

    def take(self, trial_id: str, report: Report) -> None:
        """Store a report; an episode without a checkpoint is kept for `commit`."""
        match report:
            case Recorded():
                self._unstored.append((trial_id, report))
                if report.checkpoint is not None:
                    self.commit()
            case Met(hub, session):
                self._meetings.begin(trial_id, LiveSession(hub, session))
            case Playing(episode, steps):
                self._reporter.playing(self._specs[trial_id], episode, steps)
            case Said(line):
                self._say(trial_id, line)
            case Voided(episode, why):
                self.commit()
                self._store.record_void(trial_id, episode, why)
                self._say(trial_id, f"episode {episode} is void: {why}")
            case Happened(kind, text):
                self._record_event(trial_id, kind, text)
            case Joined(role, name, program, seeded):
                self.commit()
                player = self._store.record_player(trial_id, role, name, program)
                self._joined[trial_id, role] = name
                spec = self._specs[trial_id]
                self._reporter.rename(spec, spec.named(self._joined))
                self._say(trial_id, f"{player} joined")
                if not seeded:
                    self._note_unseeded(f"the {player} takes no seed: its random numbers cannot be repeated")

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
        self._meetings.end(trial_id)
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
        self._meetings.end(trial_id)
        self.commit()
        if failure is not None:
            self._store.record_failure(trial_id, failure)
            self._say(trial_id, f"Error: {failure}")
        self._reporter.end(self._specs[trial_id])

    def _record_event(self, trial_id: str, kind: str, text: str) -> None:
        self.commit()
        self._store.record_event(kind, text, trial_id)
        if kind in OF_PLAYERS:
            if text in self._said:
                return
            self._said.add(text)
        self._say(trial_id, text)

    def _note_unseeded(self, line: str) -> None:
        """Record and show, once in the run, that a player takes no seed."""
        if not any(event.kind == UNSEEDED and event.text == line for event in self._store.events()):
            self._store.record_event(UNSEEDED, line)
            self._reporter.say(line)

    def _say(self, trial_id: str, text: str) -> None:
        name = self._specs[trial_id].named(self._joined)
        for line in text.splitlines():
            self._reporter.say(line if len(self._specs) == 1 else f"{name}: {line}")
