"""What a season's workers do: play a trial, or replay one that is over."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple

from experiment_runner.competition import match
from experiment_runner.competition.match import Match, play
from experiment_runner.competition.records.verify import verify_trial
from experiment_runner.competition.starters import starter_for
from experiment_runner.executors.job import Ended, decode
from experiment_runner.executors.workers import serve
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.store.records import EpisodeResult, ReplayVerdict, TrialEnd

MODULE: Final = "experiment_runner.competition.season.worker"

prepare = match.prepare


@dataclass(frozen=True, slots=True)
class Replay:
    """A job: a trial that is over is verified; see `verify_trial`."""

    spec: TrialSpec
    path: Path
    outcome: TrialEnd
    episodes: tuple[EpisodeResult, ...]
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
            send(Verified(verify_trial(job.spec, job.path, job.outcome, job.episodes, job.steps)))
            send(Ended(None))


def main() -> None:
    """Do the work received over the socket whose descriptor is the first argument."""
    serve(work)


if __name__ == "__main__":
    main()
