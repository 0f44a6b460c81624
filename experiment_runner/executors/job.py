"""A trial as a job, and the reports that it sends back, in order, to the only process that writes the store.

Between processes, jobs and reports are a stream of msgpack values.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final, NamedTuple, TypeVar, get_args

import msgpack

from experiment_runner.executors.settings import RunConfig
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.store.records import Answer, Checkpoint, EpisodeResult, Reading
from glue.errors import ExperimentError

_T = TypeVar("_T")

_MAX_MESSAGE: Final = 2**31 - 1
"""Maximum size of a job or report in bytes; most of it is a checkpoint."""


class Start(NamedTuple):
    """The start of a trial: the episode after which it starts, the checkpoint, and the sums of the steps and
    of the returns until then.
    """

    after: int = 0
    checkpoint: Checkpoint | None = None
    steps: int = 0
    reward: float = 0.0


BEGINNING = Start()


class Job(NamedTuple):
    """A trial to start or to continue: its spec, the settings of its execution, and where it starts."""

    spec: TrialSpec
    config: RunConfig
    start: Start = BEGINNING


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


class AtHub(NamedTuple):
    """The trial is played at the hub of this URL, in this session."""

    hub: str
    session: str


class Playing(NamedTuple):
    """An episode has not ended for a while; it has this many steps so far, None if that is not known."""

    episode: int
    steps: int | None


class Line(NamedTuple):
    """A line to show to the user."""

    line: str


class Ended(NamedTuple):
    """The trial is over; `failure` is the reason if it could not be finished, otherwise None."""

    failure: str | None


class Lost(NamedTuple):
    """The process that ran the trial ended without reporting it; `why` is the known reason."""

    why: str


Report = Recorded | Voided | Happened | Joined | AtHub | Playing | Line | Ended | Lost


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
