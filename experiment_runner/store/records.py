"""What a run directory records: episodes, answers, checkpoints, trials, voids and events."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from experiment_runner.plan import TrialSpec

__all__ = [
    "Answered",
    "Checkpoint",
    "EpisodeResult",
    "Event",
    "Outcome",
    "Totals",
    "TrialRecord",
    "Verdict",
    "Void",
]


class EpisodeResult(NamedTuple):
    """One finished episode.

    episode         counts from 1 in each trial
    episode_return  undiscounted sum of the rewards
    steps           as RL_num_steps
    terminal        False when the step limit truncated it
    wall_time       seconds
    """

    episode: int
    episode_return: float
    steps: int
    terminal: bool
    wall_time: float


class Answered(NamedTuple):
    """What the agent of a trial answered to a message after an episode."""

    trial_id: str
    episode: int
    message: str
    answer: str


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """The state a trial continues from: the bytes of `agent_save` and `env_save`, which may be empty."""

    agent: bytes
    environment: bytes = b""


class TrialRecord(NamedTuple):
    """The progress of a trial.

    spec     the trial
    done     episodes recorded
    voids    attempts at an episode that do not count
    failure  why it failed; None if it did not
    """

    spec: TrialSpec
    done: int
    voids: int
    failure: str | None

    @property
    def finished(self) -> bool:
        return self.done == self.spec.episodes


class Totals(NamedTuple):
    """Sums over all episodes of a trial, or over the last few.

    episodes         how many
    steps            of all of them
    cut_off          how many were truncated by the step limit
    sum_of_returns   0.0 when there are no episodes, NaN when a return is NaN
    """

    episodes: int
    steps: int
    cut_off: int
    sum_of_returns: float


class Void(NamedTuple):
    """An attempt at an episode that does not count, because a peer was lost. `time`: seconds since 1970."""

    time: float
    trial_id: str
    episode: int
    why: str


class Event(NamedTuple):
    """An event of a run, or of one of its trials. `time`: seconds since 1970, UTC."""

    time: float
    trial_id: str | None
    kind: str
    text: str


class Outcome(NamedTuple):
    """How a trial of a competition ended.

    reason  why its entrant forfeited it; None if it played to the end
    digest  SHA-256 of the trial's record
    """

    reason: str | None
    digest: bytes


class Verdict(NamedTuple):
    """The result of replaying the record of a trial.

    digest   SHA-256 of the record that was replayed
    problem  what did not match; None if everything did
    score    the sum of all rewards, or what a passive agent earns if the trial was forfeited; NaN if there
             is a problem
    """

    digest: bytes
    problem: str | None
    score: float
