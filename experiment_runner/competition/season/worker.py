"""A worker of a season: it plays a trial, or replays one that is over."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

from experiment_runner.competition import match
from experiment_runner.competition.match import Match, play
from experiment_runner.competition.records.verify import judge
from experiment_runner.competition.starters import starter_for
from experiment_runner.executors.job import Ended, decode
from experiment_runner.executors.workers import serve
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.store.records import ReplayVerdict, TrialEnd
from experiment_runner.store.results import Results

MODULE: Final = "experiment_runner.competition.season.worker"

prepare: Callable[[Sequence[str]], None] = match.prepare


@dataclass(frozen=True, slots=True)
class Replay:
    """A job: a trial that is over is replayed; see `judge`.

    Args:
        directory: of the run.
        spec, outcome, steps: as of `judge`.
    """

    directory: Path
    spec: TrialSpec
    outcome: TrialEnd
    steps: int


class Verified(NamedTuple):
    """A trial was replayed."""

    verdict: ReplayVerdict


REPORTS: Final[Mapping[str, type[Any]]] = {**match.REPORTS, Verified.__name__: Verified}
"""The reports of both, by name."""


def work(value: Any, send: Callable[[object], None]) -> None:
    """Play the trial of a `Match`, or verify that of a `Replay`; see `decode`."""
    match decode(value, {Match.__name__: Match, Replay.__name__: Replay}):
        case Match() as job:
            play(job, send, starter_for(job.entrant))
        case Replay() as job:
            with Results.open(job.directory) as results:
                send(Verified(judge(results, job.spec, job.outcome, job.steps)))
            send(Ended(None))


def main() -> None:
    """Do the work received over the socket whose descriptor is the first argument."""
    serve(work)


if __name__ == "__main__":
    main()
