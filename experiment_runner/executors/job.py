"""One trial as a job for an executor, and the reports that it sends back.

Reports are sent, in order, to the only process that writes the store, see
`experiment_runner.executors.dispatch`. Between processes, jobs and reports are a stream of msgpack values.
"""

from __future__ import annotations

import json
import threading
import traceback
from collections.abc import Callable, Iterator
from dataclasses import asdict
from typing import Any, Final, NamedTuple

import msgpack

from experiment_runner.asking import Answer
from experiment_runner.executors.trial import BEGINNING, Start, run_trial
from experiment_runner.interrupts import Interrupts
from experiment_runner.plan import RoleSpec, TrialSpec
from experiment_runner.players import Meeting, open_experiment
from experiment_runner.recording import Recorder
from experiment_runner.store.database import StorageError
from experiment_runner.store.records import Checkpoint, EpisodeResult
from glue.console import show_failure
from glue.errors import ConfigError, ExperimentError, GlueError, HubUnreachable, PeerFailed, Refused
from glue.trajectory import TrajectoryWriter

__all__ = [
    "Ended",
    "Happened",
    "Job",
    "Lost",
    "Recorded",
    "Report",
    "Said",
    "Voided",
    "decode_job",
    "decode_report",
    "encode_job",
    "encode_report",
    "pack",
    "run_job",
    "unpack",
    "unpacker",
]

_MAX_MESSAGE: Final = 2**31 - 1
"""Maximum size of a job or report in bytes; most of it is a checkpoint."""


class Job(NamedTuple):
    """A trial to start or to continue.

    spec              the trial
    meeting           how its players are connected
    start             where it starts
    checkpoint_every  episodes between checkpoints; 0 for none
    questions         messages that the agent is sent after each episode, and each recorded step
    """

    spec: TrialSpec
    meeting: Meeting
    start: Start = BEGINNING
    checkpoint_every: int = 0
    questions: tuple[str, ...] = ()


class Recorded(NamedTuple):
    """An episode is finished, possibly with a checkpoint and the agent's answers after it."""

    result: EpisodeResult
    checkpoint: Checkpoint | None
    answers: tuple[Answer, ...] = ()


class Voided(NamedTuple):
    """An attempt at an episode does not count."""

    episode: int
    why: str


class Happened(NamedTuple):
    """An event to be recorded with the results."""

    kind: str
    text: str


class Met(NamedTuple):
    """The trial is played at the hub of this URL, in this session."""

    hub: str
    session: str


class Said(NamedTuple):
    """A line to show to the user."""

    line: str


class Ended(NamedTuple):
    """The trial is over; `failure` is the reason if it could not be finished, otherwise None."""

    failure: str | None


class Lost(NamedTuple):
    """The process that ran the trial ended without reporting it; `why` is the known reason."""

    why: str


Report = Recorded | Voided | Happened | Met | Said | Ended | Lost


def run_job(
    job: Job,
    send: Callable[[Report], None],
    *,
    interrupts: Interrupts | None = None,
    recording: TrajectoryWriter | None = None,
) -> None:
    """Run a trial and send its reports, the last of which is `Ended`.

    Args:
        job: what to run.
        send: takes a report; calls never overlap.
        interrupts: lets the running episode end before Ctrl-C takes effect; None to not defer it.
        recording: receives every step; None for no recording.

    Raises:
        StorageError: from `send`, when a report cannot be stored.
        BrokenPipeError: from `send`, when its output is no longer read.
        ConfigError, HubUnreachable, Refused: the running hub that the players are to meet at cannot be found,
            does not answer or does not admit us. The trial has not failed: it can continue another time.
    """
    lock = threading.Lock()  # the threads that watch players report, too

    def send_alone(report: Report) -> None:
        with lock:
            send(report)

    failure = None
    sender = _Sender(send_alone, job.start.after)
    try:
        with open_experiment(
            job.spec,
            job.meeting,
            lambda line: send_alone(Said(line)),
            lambda: sender.done,
            sender.event,
            lambda hub, session: send_alone(Met(hub, session)),
        ) as glue:
            run_trial(
                glue,
                job.spec,
                sender,
                start=job.start,
                checkpoint_every=job.checkpoint_every,
                interrupts=interrupts,
                any_reward=job.meeting.any_reward,
                recorder=None if recording is None else Recorder(recording, job.spec, glue, job.questions),
                questions=job.questions,
            )
    except (StorageError, BrokenPipeError):
        raise
    except GlueError as error:
        if job.meeting.hub.hub is not None and isinstance(error, ConfigError | HubUnreachable | Refused):
            raise
        if isinstance(error, PeerFailed) and not isinstance(error.__cause__, GlueError | None):
            show_failure(error.__cause__)
        failure = str(error)
    except (Exception, SystemExit) as error:
        traceback.print_exception(error)
        failure = f"{type(error).__name__}: {error}"
    send_alone(Ended(failure))


class _Sender:
    """Sends a trial's results as reports.

    Attributes:
        done: the newest episode; initially the one after which the trial starts.
    """

    def __init__(self, send: Callable[[Report], None], done: int) -> None:
        self._send = send
        self.done = done

    def record(
        self, result: EpisodeResult, checkpoint: Checkpoint | None, answers: tuple[Answer, ...]
    ) -> None:
        self._send(Recorded(result, checkpoint, answers))
        self.done = result.episode

    def void(self, episode: int, why: str) -> None:
        self._send(Voided(episode, why))

    def event(self, kind: str, text: str) -> None:
        self._send(Happened(kind, text))

    def say(self, line: str) -> None:
        self._send(Said(line))


_REPORTS: Final = {kind.__name__: kind for kind in (Recorded, Voided, Happened, Met, Said, Ended, Lost)}


def unpacker() -> Any:
    """Return msgpack's unpacker for a stream of jobs or reports."""
    return msgpack.Unpacker(max_buffer_size=_MAX_MESSAGE)


def unpack(data: bytes) -> Iterator[Any]:
    """Yield the values of jobs or reports that are complete in `data`."""
    stream = unpacker()
    stream.feed(data)
    yield from stream


def pack(value: object) -> bytes:
    """Return a value of msgpack's as bytes, for a stream that `unpacker` reads."""
    return bytes(msgpack.packb(value))


def encode_job(job: Job) -> bytes:
    """Return a job as bytes. Its players are in one process, or use a hub that the executor starts."""
    header = [
        json.dumps(asdict(job.spec)),
        job.meeting.in_process,
        job.meeting.any_reward,
        job.checkpoint_every,
        job.questions,
        job.start.after,
    ]
    return pack([*header, _saved(job.start.checkpoint)])


def decode_job(value: Any) -> Job:
    """Return the job from an unpacked value of `encode_job`."""
    trial, in_process, any_reward, checkpoint_every, questions, after, saved = value
    fields = json.loads(trial)
    for role in ("agent", "environment"):
        if fields[role] is not None:
            fields[role] = RoleSpec(**fields[role])
    checkpoint = None if saved is None else Checkpoint(*saved)
    return Job(
        TrialSpec(**fields),
        Meeting(in_process, any_reward=any_reward),
        Start(after, checkpoint),
        checkpoint_every,
        tuple(questions),
    )


def encode_report(report: Report) -> bytes:
    """Return a report as bytes."""
    fields = [*report]
    if isinstance(report, Recorded):
        fields[1] = _saved(report.checkpoint)
    return pack([type(report).__name__, *fields])


def decode_report(value: Any) -> Report:
    """Return the report from an unpacked value of `encode_report`.

    Raises:
        ExperimentError: the value is not a report.
    """
    try:
        kind, *fields = value
        report = _REPORTS[kind](*fields)
        if isinstance(report, Recorded):
            result, saved, answers = fields
            checkpoint = None if saved is None else Checkpoint(*saved)
            return Recorded(EpisodeResult(*result), checkpoint, tuple(Answer(*one) for one in answers))
    except (TypeError, ValueError, KeyError) as error:
        raise ExperimentError(f"this is not a report: {value!r:.80}") from error
    return report


def _saved(checkpoint: Checkpoint | None) -> list[bytes] | None:
    return None if checkpoint is None else [checkpoint.agent, checkpoint.environment]
