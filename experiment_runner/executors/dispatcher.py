"""Dispatch of jobs to an executor: their reports are passed on, and lost jobs are restarted.

A job belongs to one trial of a run: an experiment's trial, or a match of a competition.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Iterable
from contextlib import AbstractContextManager
from typing import Any, Final, Protocol

from experiment_runner.executors.interrupts import Interrupts
from experiment_runner.executors.job import Ended, Lost

_MAX_LOSSES: Final = 3
"""Number of consecutive losses without progress after which a job has failed."""

_WAIT_SECONDS: Final = 0.1


class Executor(AbstractContextManager["Executor"], Protocol):
    """Interface that runs jobs, which have the trial as `spec`. Leaving its context ends them all.

    Attributes:
        size: maximum number of concurrent jobs.
    """

    size: int

    def start(self, job: Any) -> None:
        """Start a job. It is over when `receive` returns `Ended` or `Lost` for its trial."""
        ...

    def receive(self, seconds: float) -> list[tuple[str, Any]]:
        """Return reports with the ids of their trials, in order for each trial; wait at most `seconds`."""
        ...

    def cancel(self, trial_id: str) -> None:
        """End the job of a trial at once; `receive` returns nothing more for it."""
        ...

    def stop(self) -> None:
        """Ask all jobs to end soon: the run is interrupted."""
        ...


class Collector(Protocol):
    """Interface that makes the jobs of a run and stores their reports. Its methods may raise StorageError."""

    def may_start(self, trial_id: str, running: Collection[str]) -> bool:
        """Return whether a trial may start while others are running."""
        ...

    def start(self, trial_id: str) -> Any:
        """Return the job of a trial that starts now, for the first time or again."""
        ...

    def take(self, trial_id: str, report: Any) -> None:
        """Store a report."""
        ...

    def commit(self) -> None:
        """Store the reports kept so far."""
        ...

    def lost(self, trial_id: str, why: str) -> int:
        """Store that a job was lost; return the progress of its trial, which grows as it is played."""
        ...

    def starts_again(self, trial_id: str) -> bool:
        """Prepare a lost trial to start again; return False if nothing is left to do."""
        ...

    def end(self, trial_id: str, failure: str | None) -> None:
        """Store that a trial is over, and the reason if it has failed."""
        ...


class Dispatcher:
    """Dispatcher of the jobs of trials to an executor.

    Args:
        executor: runs the jobs.
        collector: makes the jobs, and stores their reports.
        interrupts: gives jobs time to end before Ctrl-C takes effect.

    Attributes:
        running: ids of the trials whose jobs run.
    """

    def __init__(self, executor: Executor, collector: Collector, interrupts: Interrupts) -> None:
        self._executor = executor
        self._collector = collector
        self._interrupts = interrupts
        self.running: set[str] = set()
        self._waiting: deque[str] = deque()
        self._stopped = False
        self._losses: dict[str, tuple[int, int]] = {}
        """The progress of each lost trial, and the number of its losses without further progress."""

    def run(self, trial_ids: Iterable[str], between: Callable[[], None] = lambda: None) -> None:
        """Run trials, as many at a time as the executor takes.

        Args:
            trial_ids: of the trials, after those that wait already.
            between: called again and again meanwhile; may add trials.

        Raises:
            StorageError: a report cannot be stored.
            ExperimentError: the executor cannot run anything.
            KeyboardInterrupt: on Ctrl-C or SIGTERM.
        """
        self._waiting.extend(trial_ids)
        with self._executor, self._interrupts.deferred():
            while self.turn(_WAIT_SECONDS):
                between()

    def add(self, trial_id: str) -> None:
        """Let a trial wait for its start."""
        self._waiting.append(trial_id)

    def postpone(self, trial_ids: Collection[str]) -> None:
        """Let those of these trials that wait start after all others that wait now."""
        self._waiting = deque(sorted(self._waiting, key=trial_ids.__contains__))

    def cancel(self, trial_id: str) -> None:
        """Forget a trial that waits or runs."""
        self._losses.pop(trial_id, None)
        if trial_id in self.running:
            self.running.remove(trial_id)
            self._executor.cancel(trial_id)
        elif trial_id in self._waiting:
            self._waiting.remove(trial_id)

    def turn(self, seconds: float) -> bool:
        """Start the trials that may start, and pass on the reports that come within `seconds`, inside the
        executor's context; return whether there is anything left to do.

        Raises:
            StorageError: a report cannot be stored.
            ExperimentError: the executor cannot run anything.
        """
        executor, collector, running = self._executor, self._collector, self.running
        while not self._stopped and (trial_id := self._next(running)) is not None:
            running.add(trial_id)
            executor.start(collector.start(trial_id))
        for trial_id, report in executor.receive(seconds) if running else ():
            if trial_id not in running:  # cancelled meanwhile
                continue
            match report:
                case Ended(failure):
                    running.remove(trial_id)
                    self._losses.pop(trial_id, None)
                    collector.end(trial_id, failure)
                case Lost(why):
                    running.remove(trial_id)
                    if not self._stopped:  # otherwise the job was asked to stop
                        self._lose(trial_id, why)
                case _:
                    collector.take(trial_id, report)
        collector.commit()
        if self._interrupts.requested and not self._stopped:
            self._stopped = True
            executor.stop()
        return bool(running or (self._waiting and not self._stopped))

    def _next(self, running: Collection[str]) -> str | None:
        """Remove and return the first trial that may start now; None if there is none."""
        if len(running) < self._executor.size:
            for trial_id in self._waiting:
                if self._collector.may_start(trial_id, running):
                    self._waiting.remove(trial_id)
                    return trial_id
        return None

    def _lose(self, trial_id: str, why: str) -> None:
        progress = self._collector.lost(trial_id, why)
        furthest, count = self._losses.get(trial_id, (-1, 0))
        count = 1 if progress > furthest else count + 1
        self._losses[trial_id] = (max(progress, furthest), count)
        if count == _MAX_LOSSES:
            del self._losses[trial_id]
            self._collector.end(trial_id, f"{why}, {count} times without progress")
        elif self._collector.starts_again(trial_id):
            self._waiting.appendleft(trial_id)
        else:
            self._collector.end(trial_id, None)
