"""What a run directory records: episodes, checkpoints, trials, voids and events."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from experiment_runner.plan import TrialSpec

__all__ = ["Checkpoint", "EpisodeResult", "Event", "Totals", "TrialRecord", "Void"]


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


@dataclass(frozen=True, slots=True)
class Checkpoint:
    """What a trial continues from: the bytes of `agent_save` and `env_save`, empty where there are none."""

    agent: bytes
    environment: bytes = b""


class TrialRecord(NamedTuple):
    """How far a trial is: episodes recorded, episodes voided, and why it failed if it did."""

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
    """An attempt at an episode that does not count, because a peer was lost. Time: seconds since 1970."""

    time: float
    trial_id: str
    episode: int
    why: str


class Event(NamedTuple):
    """Something that happened to a run, or to one of its trials. Time: seconds since 1970."""

    time: float
    trial_id: str | None
    kind: str
    text: str
