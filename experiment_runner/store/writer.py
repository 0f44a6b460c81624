"""The one end at which the store is written: jobs go out here, and reports come in."""

from __future__ import annotations

from experiment_runner.executors.work import Ended, Happened, Job, Lost, Recorded, Report, Said, Voided
from experiment_runner.players import Meeting
from experiment_runner.report.progress import Reporter
from experiment_runner.resume import Remaining, go_back, remaining
from experiment_runner.store.store import Store
from experiment_runner.trial import BEGINNING, Start

__all__ = ["Writer"]


class Writer:
    """Puts what trials report into the store, and then tells the reporter.

    Args:
        store: open for writing.
        reporter: is told what happens.
        meeting: how the players of each trial meet.
        checkpoint_every: episodes between checkpoints; 0 for none.
    """

    def __init__(self, store: Store, reporter: Reporter, meeting: Meeting, checkpoint_every: int) -> None:
        self._store = store
        self._reporter = reporter
        self._meeting = meeting
        self._every = checkpoint_every
        self._specs = {record.spec.id: record.spec for record in store.trials()}

    def job(self, trial: Remaining) -> Job:
        """Return what is to be done of a trial, which begins now."""
        spec = self._specs[trial.trial_id]
        self._reporter.begin(spec, trial.after)
        found = self._store.checkpoint(spec.id) if trial.after else None
        return Job(spec, self._meeting, Start(*found) if found else BEGINNING, self._every)

    def take(self, trial_id: str, report: Report) -> None:
        """Store a report.

        Raises:
            StorageError: it cannot be stored.
        """
        store, reporter, spec = self._store, self._reporter, self._specs[trial_id]
        match report:
            case Recorded(result, checkpoint):
                store.record(trial_id, result, checkpoint)
                reporter.episode(spec, result)
            case Voided(episode, why):
                store.record_void(trial_id, episode, why)
                self._say(trial_id, f"episode {episode} is void: {why}")
            case Happened(kind, text):
                store.record_event(kind, text, trial_id)
                self._say(trial_id, text)
            case Said(line):
                self._say(trial_id, line)
            case Lost(why):
                store.record_event("lost", why, trial_id)
                self._say(trial_id, why)
            case Ended(failure):
                if failure is not None:
                    store.record_failure(trial_id, failure)
                    self._say(trial_id, f"Error: {failure}")
                reporter.end(spec)

    def again(self, trial_id: str) -> Remaining | None:
        """Return what remains of a trial that was lost, made ready to go on; None if nothing does."""
        for trial in remaining(self._store):
            if trial.trial_id == trial_id:
                go_back(self._store, trial)
                return trial
        return None

    def done(self, trial_id: str) -> int:
        """Return how many episodes of a trial are stored."""
        return self._store.done(trial_id)

    def _say(self, trial_id: str, text: str) -> None:
        for line in text.splitlines():
            self._reporter.say(line if len(self._specs) == 1 else f"{trial_id}: {line}")
