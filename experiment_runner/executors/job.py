"""A trial as a job, and the reports that it sends back, in order, to the only process that writes the store.

Between processes, jobs and reports are a stream of msgpack values.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, NamedTuple, TypeVar, get_args

import msgpack

from experiment_runner.plan.limits import CHECKPOINT_EVERY, Backend
from experiment_runner.plan.metrics import MetricsPlan, Summary
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.store.records import Answer, Checkpoint, EpisodeResult, Reading
from glue.errors import ExperimentError
from glue.hub.config import DEFAULT_SESSION, LegacyPort
from glue.hub.io.listener import OpenAddress
from glue.wire.messages import PLAYERS, Role

GRACE_SECONDS: Final = 0.5
"""Default time in which a running episode may end before Ctrl-C takes effect."""

BOTH: Final = frozenset(PLAYERS)
"""Both players."""


@dataclass(frozen=True, slots=True)
class HubOptions:
    """The hub at which the players meet.

    Args:
        hub: URL of a running hub; None to start one.
        bind: addresses of our own hub for players from outside; by default one, if any player is expected.
        session: the session's name.
        wait: timeout in seconds for `hub` to answer; None to wait forever.
        insecure: allow addresses that other machines can reach.
        legacy: ports of our own hub for original RL-Glue programs.
        key: file with the secret key by which `hub` knows the experiment, and the players that it starts.
        hub_key: the public key of `hub`, or a file that holds it.
        keys: directory of the keys of our own hub, which players from outside need; None for none.
    """

    hub: str | None = None
    bind: tuple[str, ...] = ()
    session: str = DEFAULT_SESSION
    wait: float | None = None
    insecure: bool = False
    legacy: tuple[LegacyPort, ...] = ()
    key: str | None = None
    hub_key: str | None = None
    keys: Path | None = None


@dataclass(frozen=True, slots=True)
class Placement:
    """The places of a trial's players, and how they are connected.

    Args:
        inside: roles whose named players are objects in the process of the trial. Any other player is a
            process, or joins from outside. If both are inside, there is no hub.
        hub: the hub, if a player is not inside.
        opened: the hub's addresses that are already open, by URL.
        opened_legacy: the hub's ports for original RL-Glue programs that are already open.
        any_reward: whether rewards may be infinite or NaN; if not, the first such reward ends the trial, or
            the first such return with an environment from outside.
        check_actions: whether a named environment refuses an action that its task spec or mask forbids.
    """

    inside: frozenset[Role] = frozenset()
    hub: HubOptions = field(default_factory=HubOptions)
    opened: Mapping[str, OpenAddress] = field(default_factory=dict)
    opened_legacy: Mapping[LegacyPort, OpenAddress] = field(default_factory=dict)
    any_reward: bool = False
    check_actions: bool = False

    @property
    def in_process(self) -> bool:
        """Whether both players are objects in the process of the trial."""
        return self.inside >= BOTH


@dataclass(frozen=True, slots=True)
class RunConfig:
    """The settings of the execution of a run.

    Args:
        placement: of the players of each trial.
        checkpoint_every: number of episodes between checkpoints; 0 for none.
        backend: the kind of machine on which trials run.
        workers: maximum number of concurrent trials, each in its own process, or of a job array's tasks. None
            for one trial at a time in this process, one for each processor of a cluster, or no limit.
        address: address of the Ray cluster; None for the one that Ray finds, or one on this machine.
        questions: messages to send to the agent after each episode, and each recorded step.
        metrics: the agents' metrics to record; None for none.
        extras: the environments' extras to record, and as what; see `experiment_runner.plan.metrics`.
        grace: seconds in which a running episode may end before Ctrl-C takes effect.
    """

    placement: Placement = field(default_factory=Placement)
    checkpoint_every: int = CHECKPOINT_EVERY
    backend: Backend = Backend.LOCAL
    workers: int | None = None
    address: str | None = None
    questions: tuple[str, ...] = ()
    metrics: MetricsPlan | None = None
    extras: Mapping[str, Summary] = field(default_factory=dict)
    grace: float = GRACE_SECONDS

    @property
    def parallel(self) -> bool:
        """Whether trials run in separate processes, at the same time."""
        return self.backend is not Backend.LOCAL or self.workers is not None


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

    A job's players are in one process, or use a hub that the executor starts. Paths and ids become text.
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
        return msgspec.convert(fields, kinds[name], dec_hook=lambda kind, text: kind(text))
    except (TypeError, ValueError, KeyError, msgspec.ValidationError) as error:
        raise ExperimentError(f"expected {', '.join(kinds)}, got {value!r:.80}") from error
