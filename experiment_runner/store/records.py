"""The records of a run directory: episodes and their measures, checkpoints, trials, players, events."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Annotated, Final, NamedTuple

from msgspec import Meta

from experiment_runner.plan.plan import TrialSpec
from glue.engine.experiment import Experiment
from glue.options import Value

UNMETERED: Final = "unmetered"
"""Kind of the event of a metric that is not recorded."""

OF_PLAYERS: Final = ("unsaved", UNMETERED)
"""Kinds of events that say the same of every trial of a player: each text is shown once."""

UNSEEDED: Final = "unseeded"
"""Kind of the event of a player that takes no seed."""

MAX_ANSWER: Final = 10_000
"""Maximum length of a stored answer, in characters."""


class EpisodeResult(NamedTuple):
    """One finished episode: its number in the trial, from 1, and each of `MEASURES`."""

    episode: int
    episode_return: float
    steps: int
    terminal: bool
    wall_time: float
    late: float = 0

    def repeats(self, other: EpisodeResult) -> bool:
        """Return whether the repeatable measures agree with those of another execution of the episode."""
        return self.episode == other.episode and all(
            _agree(getattr(self, field), getattr(other, field))
            for field, measure in zip(self._fields[1:], MEASURES.values(), strict=True)
            if measure.repeatable
        )


def _agree(one: float, other: float) -> bool:
    """Return whether two values of a measure agree; NaN means unknown, as in rows older than the measure."""
    return one == other or math.isnan(one) or math.isnan(other)


class EndedEpisode(NamedTuple):
    """An episode that has just ended, from which its measures are read.

    glue      the experiment, before its next verb
    terminal  False if the step limit truncated the episode
    seconds   duration of the episode
    """

    glue: Experiment
    terminal: bool
    seconds: float


class Measure(NamedTuple):
    """A property of each episode that is recorded, exported and plotted.

    kind        type of its values
    sql         definition of its column in the database
    label       title of a figure's axis
    read        returns its value for an episode that has just ended
    repeatable  whether a repetition with the same seeds has the same value
    """

    kind: type[Value]
    sql: str
    label: str
    read: Callable[[EndedEpisode], Value]
    repeatable: bool = True


def _late(played: EndedEpisode) -> Value:
    late = played.glue.late_actions()
    return math.nan if late is None else late


MEASURES: Final[dict[str, Measure]] = {
    "return": Measure(
        float, "episode_return REAL", "episode return (reward)", lambda played: played.glue.rl_return()
    ),
    "steps": Measure(
        int, "steps INTEGER NOT NULL", "steps of an episode", lambda played: played.glue.rl_num_steps()
    ),
    "terminal": Measure(
        bool,
        "terminal INTEGER NOT NULL CHECK (terminal IN (0, 1))",
        "terminal (share of the episodes)",
        lambda played: played.terminal,
    ),
    "wall_time": Measure(
        float, "wall_time REAL NOT NULL", "duration of an episode (s)", lambda played: played.seconds, False
    ),
    "late": Measure(int, "late INTEGER", "late actions of an episode", _late, False),
}
"""The measures of an episode by name, in the order of `EpisodeResult` and of the columns of the database.

A new measure is the last of these, the last field of `EpisodeResult`, with a default, and the last migration
of `experiment_runner.store.schema`. It is NaN in episodes that were recorded before.
"""


def measured(episode: int, played: EndedEpisode) -> EpisodeResult:
    """Return the result of an episode that has just ended."""
    return EpisodeResult._make((episode, *(measure.read(played) for measure in MEASURES.values())))


def known_measures(result: EpisodeResult) -> dict[str, Value]:
    """Return the measures of an episode that are known, by name; the return may be NaN."""
    values = zip(MEASURES, result[1:], strict=True)
    return {name: value for name, value in values if name == "return" or not math.isnan(value)}


TUNED: Final = "tuned"
"""Kind of the event of an agent whose options were chosen by a search."""

TOTAL_REWARD: Final = "total reward"
"""The trial's own metric: the undiscounted sum of all rewards since its beginning."""


class Reading(NamedTuple):
    """Values of an agent's metrics, and of `TOTAL_REWARD`, that were read at the same time.

    step    steps of the trial until then
    values  by name; may be infinite or NaN
    """

    step: int
    values: dict[str, float]


class Answered(NamedTuple):
    """The answer of a trial's agent to a message after an episode."""

    trial_id: str
    episode: int
    message: str
    answer: str


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """The state a trial continues from: the bytes of `agent_save` and `env_save`, which may be empty, and of
    the metrics that are averaged.
    """

    agent: bytes
    environment: bytes = b""
    metrics: bytes = b""


class TrialRecord(NamedTuple):
    """The progress of a trial.

    spec     the trial
    done     episodes recorded
    voids    attempts at an episode that do not count
    failure  why it failed; None if it did not
    steps    steps recorded, in all episodes, if the trial has a budget of steps; otherwise 0
    """

    spec: TrialSpec
    done: int
    voids: int
    failure: str | None
    steps: int = 0

    @property
    def finished(self) -> bool:
        return self.spec.finished_by(self.done, self.steps)

    @property
    def progress(self) -> str:
        """The recorded part of the trial's length, as in `20/100` or `5,000/20,000 steps`."""
        spec = self.spec
        return f"{self.steps:,}/{spec.steps:,} steps" if spec.steps else f"{self.done}/{spec.episodes}"


class Totals(NamedTuple):
    """Sums over all episodes of a trial, or over the last few.

    episodes         number of episodes
    steps            number of steps in all of them
    cut_off          number of episodes truncated by the step limit
    sum_of_returns   0.0 when there are no episodes, NaN when a return is NaN
    """

    episodes: int
    steps: int
    cut_off: int
    sum_of_returns: float


_Time = Annotated[float, Meta(ge=0, le=253_402_300_799)]
"""Seconds since 1970, UTC, up to the year 9999, the last that a date can have."""


class Void(NamedTuple):
    """An attempt at an episode that does not count, because a peer was lost."""

    time: _Time
    trial_id: str
    episode: int
    why: str


class RunEvent(NamedTuple):
    """An event of a run, or of one of its trials."""

    time: _Time
    trial_id: str | None
    kind: str
    text: str


class OutsidePlayer(NamedTuple):
    """A player that joined a trial from outside.

    time      of joining
    trial_id  of the trial
    role      agent or environment
    name      as it called itself
    program   its language or library; None if unknown
    """

    time: _Time
    trial_id: str
    role: str
    name: str
    program: str | None

    def __str__(self) -> str:
        return f"{self.role} {self.name}" + (f" ({self.program})" if self.program else "")


class TrialEnd(NamedTuple):
    """The end of a competition's trial.

    reason  why its entrant forfeited it; None if it played to the end
    digest  SHA-256 of the trial's record
    """

    reason: str | None
    digest: bytes


class ReplayVerdict(NamedTuple):
    """The result of replaying the record of a trial.

    digest   SHA-256 of the record that was replayed
    problem  what did not match; None if everything did
    score    the sum of all rewards, or that of a passive agent if the trial was forfeited; NaN if there
             is a problem
    """

    digest: bytes
    problem: str | None
    score: float


class Answer(NamedTuple):
    """An agent's answer to a message."""

    message: str
    answer: str


def ask(glue: Experiment, messages: Sequence[str]) -> tuple[Answer, ...]:
    """Send each message to the agent; return its answers, as text that can be stored.

    Raises:
        GlueError: the agent was lost, or has failed.
    """
    return tuple(Answer(message, _storable(glue.rl_agent_message(message))) for message in messages)


def _storable(answer: str) -> str:
    """Return the beginning of an answer, with `?` for characters that are not Unicode."""
    return answer[:MAX_ANSWER].encode("utf-8", "replace").decode()
