"""The workers of a competition, which play a trial or replay one that is over, and where they are."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Self, get_args

from experiment_runner.competition.launching import launcher_for
from experiment_runner.competition.match import Match, Report, play
from experiment_runner.competition.records.verify import judge
from experiment_runner.competition.settings import Competition, Task
from experiment_runner.executors.dispatcher import Executor
from experiment_runner.executors.job import Ended, Lost, decode
from experiment_runner.executors.workers import LocalExecutor, RayExecutor, serve
from experiment_runner.plan.limits import Backend
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.store.records import ReplayVerdict, TrialEnd
from experiment_runner.store.results import Results
from glue.options import build
from glue.plugins.loading import find
from glue.wire.messages import Role

MODULE: Final = "experiment_runner.competition.worker"


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


REPORTS: Final[Mapping[str, type[Any]]] = {one.__name__: one for one in get_args(Report | ReplayVerdict)}
"""The reports of matches and replays, by name."""


def prepare(environments: Sequence[str]) -> None:
    """Import environments and load what they have compiled, for the processes that are forked from this one.

    Those in a user's own file are left to each process: what the file does is not known.
    """
    for name in environments:
        if ":" not in name:
            with suppress(Exception):  # a process that plays says what is wrong
                build(find(Role.ENVIRONMENT, name), {}).env_init()


def work(value: Any, send: Callable[[object], None]) -> None:
    """Play the trial of a `Match`, or verify that of a `Replay`; see `decode`."""
    match decode(value, {Match.__name__: Match, Replay.__name__: Replay}):
        case Match() as job:
            play(job, send, launcher_for(job.entrant))
        case Replay() as job:
            with Results.open(job.directory) as results:
                send(judge(results, job.spec, job.outcome, job.steps))
            send(Ended(None))


def executor(size: int, tasks: Iterable[Task]) -> LocalExecutor:
    """Return the executor of so many matches and replays at once of these tasks, on this machine."""
    return LocalExecutor(size, MODULE, REPORTS, warm=[task.env for task in tasks])


def executor_of(competition: Competition, backend: Backend, address: str | None) -> Executor:
    """Return the executor of a season's matches and replays: twice the slots, so that no replay waits long.

    Args:
        competition: the competition.
        backend: this machine, or Ray.
        address: of the Ray cluster; None for the one that Ray finds.

    Raises:
        ConfigError: Ray is not installed.
    """
    assert competition.season is not None
    size = 2 * competition.season.parallel
    here = executor(size, competition.proving)
    return Spread(here, RayExecutor(address, size, work, REPORTS)) if backend is Backend.RAY else here


class Spread:
    """Executor of matches on a cluster; see `experiment_runner.executors.dispatcher.Executor`.

    Entrants with keys connect to this machine, and replays read the run's directory: both are done here.

    Args:
        here: runs these.
        there: runs all other matches.
    """

    def __init__(self, here: LocalExecutor, there: RayExecutor) -> None:
        self.size: int = here.size
        self._here = here
        self._there = there
        self._away: set[str] = set()
        self._stack = ExitStack()

    def start(self, job: Any) -> None:
        """Start a job where it can run."""
        if isinstance(job, Match) and job.entrant.key is None and job.entrant.folder is None:
            self._away.add(job.spec.id)
            self._there.start(job)
        else:
            self._here.start(job)

    def receive(self, seconds: float) -> list[tuple[str, Any]]:
        """Return reports with the ids of their trials; wait at most `seconds`."""
        if not self._away:
            return self._here.receive(seconds)
        received = self._there.receive(seconds)
        self._away -= {trial_id for trial_id, report in received if isinstance(report, (Ended, Lost))}
        return [*received, *self._here.receive(0)]

    def cancel(self, trial_id: str) -> None:
        """End the job of a trial."""
        (self._there if trial_id in self._away else self._here).cancel(trial_id)
        self._away.discard(trial_id)

    def stop(self) -> None:
        """Ask all jobs to end soon."""
        self._here.stop()
        self._there.stop()

    def __enter__(self) -> Self:
        self._stack.enter_context(self._there)
        self._stack.enter_context(self._here)
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()


def main() -> None:
    """Do the work received over the socket whose descriptor is the first argument."""
    serve(work)


if __name__ == "__main__":
    main()
