"""One trial as a piece of work: what is handed to whoever runs it, and what is reported back.

Reports go, in order, to the one process that writes the store: `experiment_runner.run.Writer`.
"""

from __future__ import annotations

import threading
import traceback
from collections.abc import Callable
from typing import NamedTuple

from experiment_runner.plan import TrialSpec
from experiment_runner.players import Meeting, open_experiment
from experiment_runner.recording import Recorder
from experiment_runner.store.database import StorageError
from experiment_runner.store.records import Checkpoint, EpisodeResult
from experiment_runner.trial import BEGINNING, Start, run_trial
from glue.errors import GlueError, PeerFailed
from glue.trajectory import TrajectoryWriter

__all__ = ["Ended", "Happened", "Job", "Lost", "Recorded", "Report", "Said", "Voided", "work"]


class Job(NamedTuple):
    """A trial to run, or to go on with.

    spec              the trial
    meeting           how its players meet
    start             where it begins
    checkpoint_every  episodes between checkpoints; 0 for none
    """

    spec: TrialSpec
    meeting: Meeting
    start: Start = BEGINNING
    checkpoint_every: int = 0


class Recorded(NamedTuple):
    """An episode is finished, and this can be continued from after it."""

    result: EpisodeResult
    checkpoint: Checkpoint | None


class Voided(NamedTuple):
    """An attempt at an episode does not count."""

    episode: int
    why: str


class Happened(NamedTuple):
    """Something that a reader of the results should know."""

    kind: str
    text: str


class Said(NamedTuple):
    """Something that a person who looks on should know."""

    line: str


class Ended(NamedTuple):
    """The trial is over; `failure` says why it could not be finished, if so."""

    failure: str | None


class Lost(NamedTuple):
    """Whoever ran the trial is gone, and said nothing; `why` is what is known of it."""

    why: str


Report = Recorded | Voided | Happened | Said | Ended | Lost


def work(job: Job, send: Callable[[Report], None], recording: TrajectoryWriter | None = None) -> None:
    """Run a trial and send what comes of it, last of all `Ended`.

    Args:
        job: what to run.
        send: takes reports, never two at once.
        recording: is written every step of the trial; None for none.

    Raises:
        StorageError: what `send` raises when a report cannot be stored.
        BrokenPipeError: what it raises when nobody reads any more what it shows.
    """
    lock = threading.Lock()  # players are watched by threads, which report as well

    def send_alone(report: Report) -> None:
        with lock:
            send(report)

    failure = None
    sender = _Sender(send_alone, job.start.after)
    try:
        with open_experiment(
            job.spec, job.meeting, lambda line: send_alone(Said(line)), lambda: sender.done
        ) as glue:
            run_trial(
                glue,
                job.spec,
                sender,
                start=job.start,
                checkpoint_every=job.checkpoint_every,
                recorder=None if recording is None else Recorder(recording, job.spec, glue),
            )
    except (StorageError, BrokenPipeError):
        raise
    except GlueError as error:
        if isinstance(error, PeerFailed) and not isinstance(error.__cause__, GlueError | None):
            traceback.print_exception(error.__cause__)  # the user's own mistake, where it happened
        failure = str(error)
    except (Exception, SystemExit) as error:
        traceback.print_exception(error)
        failure = f"{type(error).__name__}: {error}"
    send_alone(Ended(failure))


class _Sender:
    """Makes reports of what a trial hands over.

    Attributes:
        done: the episode that was handed over last; at first the one after which the trial begins.
    """

    def __init__(self, send: Callable[[Report], None], done: int) -> None:
        self._send = send
        self.done = done

    def record(self, result: EpisodeResult, checkpoint: Checkpoint | None) -> None:
        self._send(Recorded(result, checkpoint))
        self.done = result.episode

    def void(self, episode: int, why: str) -> None:
        self._send(Voided(episode, why))

    def event(self, kind: str, text: str) -> None:
        self._send(Happened(kind, text))
