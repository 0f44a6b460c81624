"""One trial as a job for an executor, and the reports that it sends back.

Reports are sent, in order, to the only process that writes the store, see
`experiment_runner.executors.dispatcher`. Between processes, jobs and reports are a stream of msgpack values.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any, Final, NamedTuple, TypeVar, get_args

import msgpack

from experiment_runner.executors.interrupts import Interrupts
from experiment_runner.executors.players import Placement, open_experiment
from experiment_runner.executors.recording import Recorder
from experiment_runner.executors.trial import BEGINNING, Start, run_trial
from experiment_runner.plan.metrics import MetricsPlan
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.store.database import StorageError
from experiment_runner.store.records import Answer, Checkpoint, EpisodeResult, Reading
from glue.console import show_failure
from glue.engine.experiment import Experiment
from glue.errors import (
    ConfigError,
    ExperimentError,
    GlueError,
    HubUnreachable,
    PeerFailed,
    Refused,
    described,
)
from glue.trajectory import TrajectoryWriter

_T = TypeVar("_T")

_LONG_SECONDS: Final = 5.0
"""Seconds after which it is reported that an episode has not ended."""

_MAX_MESSAGE: Final = 2**31 - 1
"""Maximum size of a job or report in bytes; most of it is a checkpoint."""


class Job(NamedTuple):
    """A trial to start or to continue.

    spec              the trial
    placement           the way in which its players are connected
    start             the episode and checkpoint from which it starts
    checkpoint_every  number of episodes between checkpoints; 0 for none
    questions         messages to send to the agent after each episode, and each recorded step
    metrics           the agent's metrics to record; None for none
    """

    spec: TrialSpec
    placement: Placement
    start: Start = BEGINNING
    checkpoint_every: int = 0
    questions: tuple[str, ...] = ()
    metrics: MetricsPlan | None = None


class Recorded(NamedTuple):
    """An episode is finished: its result, metrics and, if any, the checkpoint and answers after it."""

    result: EpisodeResult
    checkpoint: Checkpoint | None
    answers: tuple[Answer, ...] = ()
    metrics: tuple[Reading, ...] = ()


class Voided(NamedTuple):
    """An attempt at an episode does not count."""

    episode: int
    why: str


class Happened(NamedTuple):
    """An event to be recorded with the results."""

    kind: str
    text: str


class Joined(NamedTuple):
    """A player joined from outside; see `experiment_runner.store.records.OutsidePlayer`.

    `seeded` is false if the player is known to take no seed.
    """

    role: str
    name: str
    program: str | None
    seeded: bool = True


class Met(NamedTuple):
    """The trial is played at the hub of this URL, in this session."""

    hub: str
    session: str


class Playing(NamedTuple):
    """An episode has not ended for a while; it has this many steps so far, None if that is not known."""

    episode: int
    steps: int | None


class Said(NamedTuple):
    """A line to show to the user."""

    line: str


class Ended(NamedTuple):
    """The trial is over; `failure` is the reason if it could not be finished, otherwise None."""

    failure: str | None


class Lost(NamedTuple):
    """The process that ran the trial ended without reporting it; `why` is the known reason."""

    why: str


Report = Recorded | Voided | Happened | Joined | Met | Playing | Said | Ended | Lost


def run_job(
    job: Job,
    send: Callable[[Report], None],
    *,
    interrupts: Interrupts | None = None,
    recording: TrajectoryWriter | None = None,
) -> None:
    """Run a trial and send its reports, the last of which is `Ended`.

    Args:
        job: the trial to run.
        send: called with each report; calls never overlap.
        interrupts: lets the running episode end before Ctrl-C takes effect; None to not defer it.
        recording: receives every step; None for no recording.

    Raises:
        StorageError: from `send`, when a report cannot be stored.
        BrokenPipeError: from `send`, when its output is no longer read.
        ConfigError, HubUnreachable, Refused: the running hub for the players cannot be found, does not answer
            or does not admit this program. The trial has not failed: it can continue later.
    """
    lock = threading.Lock()  # the threads that watch players also report

    def send_alone(report: Report) -> None:
        with lock:
            send(report)

    failure = None
    sender = _Sender(send_alone, job.start.after)
    try:
        with (
            open_experiment(
                job.spec,
                job.placement,
                lambda line: send_alone(Said(line)),
                lambda: sender.done,
                lambda *player: send_alone(Joined(*player)),
                lambda hub, session: send_alone(Met(hub, session)),
            ) as glue,
            watched(glue, lambda: sender.done, send_alone),
        ):
            run_trial(
                glue,
                job.spec,
                sender,
                start=job.start,
                checkpoint_every=job.checkpoint_every,
                interrupts=interrupts,
                any_reward=job.placement.any_reward,
                recorder=None if recording is None else Recorder(recording, job.spec, glue, job.questions),
                questions=job.questions,
                metrics=job.metrics,
            )
    except (StorageError, BrokenPipeError, KeyboardInterrupt):
        raise
    except GlueError as error:
        if job.placement.hub.hub is not None and isinstance(error, ConfigError | HubUnreachable | Refused):
            raise
        if isinstance(error, PeerFailed) and not isinstance(error.__cause__, GlueError | None):
            show_failure(error.__cause__)
        failure = described(error)
    except BaseException as error:
        show_failure(error)
        failure = described(error)
    send_alone(Ended(failure))


@contextmanager
def watched(
    glue: Experiment, done: Callable[[], int], send: Callable[[Report], None], seconds: float = _LONG_SECONDS
) -> Iterator[None]:
    """Report, as often as no episode has ended for so many seconds, how far the one under way is.

    Args:
        glue: plays in this thread.
        done: returns the number of finished episodes.
        send: called with each `Playing`, in another thread.
        seconds: between two looks.
    """
    over = threading.Event()

    def watch() -> None:
        before = done()
        while not over.wait(seconds):
            now, steps = done(), glue.steps_under_way()
            if now == before and steps != 0:  # 0: it is still being initialised
                with suppress(OSError, KeyboardInterrupt):  # nobody reads the reports any more
                    send(Playing(now + 1, steps))
            before = now

    watcher = threading.Thread(target=watch, name="watcher", daemon=True)
    watcher.start()
    try:
        yield
    finally:
        over.set()
        watcher.join()


class _Sender:
    """Sink that sends a trial's results as reports.

    Attributes:
        done: the newest episode; initially the one after which the trial starts.
    """

    def __init__(self, send: Callable[[Report], None], done: int) -> None:
        self._send = send
        self.done = done

    def record(
        self,
        result: EpisodeResult,
        checkpoint: Checkpoint | None,
        answers: tuple[Answer, ...],
        metrics: tuple[Reading, ...],
    ) -> None:
        self._send(Recorded(result, checkpoint, answers, metrics))
        self.done = result.episode

    def void(self, episode: int, why: str) -> None:
        self._send(Voided(episode, why))

    def event(self, kind: str, text: str) -> None:
        self._send(Happened(kind, text))

    def say(self, line: str) -> None:
        self._send(Said(line))


REPORTS: Final = {kind.__name__: kind for kind in get_args(Report)}
"""The reports of a trial, by name."""


def unpacker() -> Any:
    """Return msgpack's unpacker for a stream of jobs or reports."""
    return msgpack.Unpacker(max_buffer_size=_MAX_MESSAGE)


def unpack(data: bytes) -> Iterator[Any]:
    """Yield the values of jobs or reports that are complete in `data`."""
    stream = unpacker()
    stream.feed(data)
    yield from stream


def encode(value: object) -> bytes:
    """Return a job or report as bytes, for a stream that `unpacker` reads.

    A job's players are in one process, or use a hub that the executor starts.
    """
    import msgspec  # slow to import

    fields = msgspec.to_builtins(value, builtin_types=(bytes,), enc_hook=str)
    return bytes(msgpack.packb([type(value).__name__, fields]))


def decode(value: Any, kinds: Mapping[str, type[_T]]) -> _T:
    """Return the job or report from an unpacked value of `encode`.

    Args:
        value: the value.
        kinds: the expected types, by name.

    Raises:
        ExperimentError: the value has none of these types.
    """
    import msgspec  # slow to import

    try:
        name, fields = value
        return msgspec.convert(fields, kinds[name], dec_hook=_construct)
    except (TypeError, ValueError, KeyError, msgspec.ValidationError) as error:
        raise ExperimentError(f"expected {', '.join(kinds)}, got {value!r:.80}") from error


def decode_job(value: Any) -> Job:
    """Return the job from an unpacked value of `encode`.

    Raises:
        ExperimentError: the value is no job.
    """
    return decode(value, {Job.__name__: Job})


def _construct(kind: type, value: Any) -> Any:
    """Return a path or a trial's id from its text."""
    return kind(value)
