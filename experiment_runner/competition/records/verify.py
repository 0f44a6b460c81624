"""Verify a competition: play every recorded action again, and compare every reward and every score.

Only what was verified is on the final board. A trial is verified if

- its record is, to the byte, the one that the organiser finished, and can be read;
- the environment, made anew from the trial's options and seed, pays the same rewards for the same actions,
  bit for bit, and ends its episodes where they ended;
- the episodes in the database are those of the record;
- it was played to its end, unless it was forfeited.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Final

import numpy as np
import numpy.typing as npt

from experiment_runner.competition.records.record import (
    End,
    Part,
    RecordError,
    digest,
    read_parts,
    record_path,
)
from experiment_runner.competition.records.replay import passive_score, replay_of
from experiment_runner.plan import TrialSpec
from experiment_runner.store.records import EpisodeResult, Outcome, Verdict
from experiment_runner.store.results import Results
from experiment_runner.store.store import Store
from glue.errors import ExperimentError, GlueError
from glue.types import Action

__all__ = ["Mismatch", "replay_trial", "verify"]


class Mismatch(ExperimentError):
    """A record and its replay, or the database, do not agree."""


def verify(store: Store, steps: Mapping[str, int], say: Callable[[str], None]) -> int:
    """Replay every trial that is over, and store the verdicts; return how many have a problem.

    Args:
        store: of the run.
        steps: how many steps each task has; 0 if its episodes count.
        say: shows a line for each problem.

    Raises:
        StorageError: the run cannot be written to.
    """
    outcomes = store.outcomes()
    problems = 0

    passive: dict[tuple[str, str], float] = {}
    for record in store.trials():
        spec = record.spec
        if spec.id not in outcomes:
            continue
        _, task, number = spec.id.split("/")
        path = record_path(store.directory, spec.id)
        sha256, problem, score = b"", None, math.nan
        try:
            sha256 = digest(path)
            score = _verified_score(store, spec, outcomes[spec.id], path, sha256, steps[task])
            if outcomes[spec.id].reason is not None:
                if (task, number) not in passive:
                    passive[task, number] = passive_score(spec, steps[task])
                score = passive[task, number]
        except GlueError as error:
            problem, score = str(error), math.nan
        except Exception as error:  # of an environment, which may have changed since
            problem, score = f"the environment failed: {type(error).__name__}: {error}", math.nan
        store.record_verdict(spec.id, Verdict(sha256, problem, score))
        if problem is not None:
            problems += 1
            say(f"{spec.id} does not match: {problem}")
    return problems


def _verified_score(
    results: Results, spec: TrialSpec, outcome: Outcome, path: Path, sha256: bytes, steps: int
) -> float:
    """Return the sum of rewards of a trial.

    Raises:
        Mismatch: something does not match.
        GlueError: the record cannot be read, or the environment cannot be made.
    """
    if sha256 != outcome.digest:
        # Found in any case; the report is as exact as possible.
        for _ in read_parts(path, spec.id):
            pass
        raise RecordError(f"{path} is not the record that was finished: bytes in it were changed")
    episodes, score = replay_trial(spec, path)
    _compare_episodes(results.episodes(spec.id), episodes)
    ends = [end for end, _, _ in episodes]
    if outcome.reason is None:
        total = sum(count for _, count, _ in episodes)
        whole = len(ends) == spec.episodes and End.FORFEIT not in ends
        complete = total == steps if steps else whole
        if not complete:
            raise Mismatch(
                f"it was not played to the end: the record has {len(ends)} episodes, {total} steps"
            )
    return score


Episode = tuple[End, int, float]
"""How it ended, its steps and its return."""


def replay_trial(spec: TrialSpec, path: Path) -> tuple[list[Episode], float]:
    """Play a record again; return its episodes, and the sum of all rewards.

    Raises:
        Mismatch: a reward or the end of an episode differs.
        RecordError: the record is damaged.
    """
    replay, _ = replay_of(spec)
    episodes: list[Episode] = []
    score, count, total, going = 0.0, 0, 0.0, False
    actions: tuple[bytes, ...] = ()
    made: list[Action] = []
    for part in read_parts(path, spec.id):
        if not going:
            replay.start()
            count, total = 0, 0.0
        if part.actions is not actions:
            actions, made = part.actions, [Action.from_body(body) for body in part.actions]
        rewards, ended = _NOTHING
        if len(part.choices):
            rewards, ended = replay.play(made, part.choices.astype(np.int64))
        _compare_part(part, rewards, ended, len(episodes) + 1, count)
        count += len(rewards)
        total, score = _add(total, rewards), _add(score, rewards)
        going = part.end is End.GOES_ON
        if not going:
            episodes.append((part.end, count, total))
    if going:
        raise Mismatch(f"the record ends in the middle of episode {len(episodes) + 1}")
    return episodes, score


_NOTHING: Final[tuple[npt.NDArray[np.float64], bool]] = (np.empty(0), False)


def _compare_part(
    part: Part, rewards: npt.NDArray[np.float64], ended: bool, episode: int, before: int
) -> None:
    recorded = part.rewards[: len(rewards)]
    differing = np.flatnonzero(recorded.view(np.uint64) != rewards.view(np.uint64))
    if len(differing):
        step = int(differing[0])
        raise Mismatch(
            f"step {before + step + 1} of episode {episode} pays {rewards[step]!r}, and the record says "
            f"{recorded[step]!r}"
        )
    # An environment may cut an episode off itself, or be cut off.
    ends_alike = part.end is End.CUT_OFF or ended is (part.end is End.TERMINAL)
    if len(rewards) < len(part.rewards) or not ends_alike:
        what = "ends" if ended else "does not end"
        raise Mismatch(f"episode {episode} {what} with step {before + len(rewards)}, and the record differs")


def _compare_episodes(stored: Sequence[EpisodeResult], replayed: Sequence[Episode]) -> None:
    whole = [episode for episode in replayed if episode[0] is not End.FORFEIT]
    if len(stored) != len(whole):
        raise Mismatch(f"the record has {len(whole)} episodes, and the database {len(stored)}")
    for row, (end, count, total) in zip(stored, whole, strict=True):
        terminal = end is End.TERMINAL
        # RL_num_steps counts observations, of which the last step of an episode has none.
        expected = (total, count if terminal else count + 1, terminal)
        found = (row.episode_return, row.steps, row.terminal)
        if found != expected:
            raise Mismatch(f"episode {row.episode} is {expected} by its record, and {found} in the database")


def _add(total: float, rewards: npt.NDArray[np.float64]) -> float:
    """Return the sum, added up one by one as in a trial: the last bits depend on it."""
    return float(np.add.accumulate(np.concatenate(([total], rewards)))[-1])
