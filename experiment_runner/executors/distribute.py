"""Hand trials out to whoever runs them, take what comes back, and give a lost one to another."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable
from types import TracebackType
from typing import Final, Protocol, Self

from experiment_runner.executors.work import Ended, Job, Lost, Report
from experiment_runner.resume import Remaining
from experiment_runner.store.writer import Writer

__all__ = ["Pool", "distribute"]

_HOPELESS_LOSSES: Final = 3


class Pool(Protocol):
    """Runs trials somewhere. After its context nothing of them runs any more.

    Attributes:
        size: how many trials at a time.
    """

    size: int

    def start(self, job: Job) -> None:
        """Run a trial. It is over when `receive` returns `Ended` or `Lost` for it."""
        ...

    def receive(self) -> list[tuple[str, Report]]:
        """Wait for reports; return them with the id of their trial, those of one trial in order."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...


def distribute(trials: Iterable[Remaining], pool: Pool, writer: Writer) -> None:
    """Run trials in a pool.

    A trial that is lost goes on from its newest checkpoint, unless it is lost three times in a row
    without getting any further: then it has failed.

    Raises:
        StorageError: a report cannot be stored.
        ExperimentError: the pool cannot run anything.
    """
    waiting = deque(trials)
    running: set[str] = set()
    losses = _Losses(writer)
    with pool:
        while waiting or running:
            while waiting and len(running) < pool.size:
                job = writer.job(waiting.popleft())
                running.add(job.spec.id)
                pool.start(job)
            for trial_id, report in pool.receive():
                writer.take(trial_id, report)
                if isinstance(report, (Ended, Lost)):
                    running.remove(trial_id)
                if isinstance(report, Lost):
                    waiting.extendleft(losses.after(trial_id, report))


class _Losses:
    """How often each trial was lost without getting further, and how far it had come."""

    def __init__(self, writer: Writer) -> None:
        self._writer = writer
        self._seen: dict[str, tuple[int, int]] = {}

    def after(self, trial_id: str, loss: Lost) -> list[Remaining]:
        """Return what remains to be run of a trial that was lost."""
        done = self._writer.done(trial_id)
        furthest, count = self._seen.get(trial_id, (-1, 0))
        count = 1 if done > furthest else count + 1
        if count == _HOPELESS_LOSSES:
            why = f"{loss.why}, {count} times without getting past episode {furthest}"
            self._writer.take(trial_id, Ended(why))
            return []
        self._seen[trial_id] = (max(done, furthest), count)
        trial = self._writer.again(trial_id)
        if trial is None:
            self._writer.take(trial_id, Ended(None))
            return []
        return [trial]
