"""Verify a competition: play every recorded action again, and compare every reward and every score.

Only verified trials count on the final board. A trial is verified if

- its record is, to the byte, the one that the organiser finished, and can be read;
- the environment, constructed from the trial's options and seed, pays the same rewards for the same actions,
  bit for bit, and ends its episodes where they ended;
- the episodes in the database are those of the record;
- it was played to its end, unless it was forfeited.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from experiment_runner.competition.records.copies import with_copies, without_place, without_places
from experiment_runner.competition.records.record import digest, record_path
from experiment_runner.competition.records.replay import Replay, passive_score, replay_of
from experiment_runner.competition.records.seal import record_verdict, reseal_verdicts, seal
from experiment_runner.executors.recording import run_of
from experiment_runner.plan.plan import TrialSpec
from experiment_runner.plan.user_files import players_of
from experiment_runner.store.records import EpisodeResult, ReplayVerdict, TrialEnd
from experiment_runner.store.results import Results
from experiment_runner.store.store import Store
from glue.console import one_line
from glue.errors import ConfigError, ExperimentError, GlueError
from glue.plugins.loading import is_installed
from glue.trajectory import ActionSteps, Ending, Episode, Run, TrajectoryReader
from glue.trajectory.comparison import Outcomes, compare
from glue.types import Action


class Mismatch(ExperimentError):
    """A record and its replay, or the database, do not agree."""


def not_installed(results: Results) -> list[str]:
    """Return the environments of a run, and opponents in them, that `verify` plays only if allowed."""
    environments = (record.spec.environment for record in results.trials())
    named = {name for one in environments if one is not None for name in players_of(one)}
    return sorted(name for name in named if not is_installed(name))


def verify(
    store: Store, steps: Mapping[str, int], say: Callable[[str], None], environments: Iterable[str] = ()
) -> int:
    """Replay every trial that is over, and store the verdicts; return the number of trials with a problem.

    A run may come from anyone, so it cannot name code that is to be run: the user does.

    Args:
        store: of the run, whose trials are of the competition's tasks, see `Course.check_trials`.
        steps: number of steps of each task; 0 if its episodes count.
        say: shows a line for each problem.
        environments: names of environments that may be played besides the installed ones. A file stands for
            one of the same name, wherever the organiser keeps that.

    Raises:
        ConfigError: a trial is of another environment, or has an opponent that is neither.
        StorageError: the run cannot be written to.
    """
    given = {without_place(name): name for name in environments}
    foreign = not_installed(store)
    specs = [_played_by(given, foreign, record.spec) for record in store.trials()]
    seal(store)
    outcomes = store.outcomes()
    problems = 0
    passive: dict[tuple[str, int], float] = {}
    for spec in specs:
        if spec.id not in outcomes:
            continue
        verdict = judge(store, spec, outcomes[spec.id], steps[spec.id.parts[1]], passive)
        record_verdict(store, spec.id, verdict)
        if verdict.problem is not None:
            problems += 1
            say(f"{spec.id} does not match: {verdict.problem}")
    reseal_verdicts(store)
    return problems


def _played_by(given: Mapping[str, str], foreign: Sequence[str], spec: TrialSpec) -> TrialSpec:
    """Return a trial of the environment that is to be played: its own, or the one given for a foreign one."""
    if (environment := spec.environment) is None:
        return spec
    name, *opponents = players_of(environment)
    found = given.get(without_place(name)) if name in foreign else name
    unknown = [one for one in opponents if one in foreign and one not in given.values()]
    if found is None or unknown:
        what = one_line(name if found is None else unknown[0])
        raise ConfigError(
            f"{spec.id} is played with {what}, which is not installed, and the run names its code: if you "
            f"trust that, allow {what}, or, of an environment, your copy of its file",
            settings=("environments",),
        )
    return replace(spec, environment=replace(environment, name=found))


def judge(
    results: Results,
    spec: TrialSpec,
    outcome: TrialEnd,
    steps: int,
    passive: dict[tuple[str, int], float] | None = None,
) -> ReplayVerdict:
    """Return the result of replaying a trial that is over.

    Args:
        results: of the run.
        spec: the trial.
        outcome: how it ended.
        steps: number of steps of its task; 0 if its episodes count.
        passive: scores of a passive agent, by task and seed, which are computed once.
    """
    path = record_path(results.directory, spec.id)
    spec = with_copies(spec, results.directory)
    passive = {} if passive is None else passive
    sha256, problem, score = b"", None, math.nan
    try:
        sha256 = digest(path)
        score = _verified_score(results, spec, outcome, path, sha256, steps)
        if outcome.reason is not None:
            level = (spec.id.parts[1], spec.seed)  # attempts and repetitions share it
            if level not in passive:
                passive[level] = passive_score(spec, steps)
            score = passive[level]
    except GlueError as error:
        problem, score = str(error), math.nan
    except Exception as error:  # from an environment, which may have changed since
        problem, score = f"the environment failed: {type(error).__name__}: {error}", math.nan
    return ReplayVerdict(sha256, problem, score)


def _verified_score(
    results: Results, spec: TrialSpec, outcome: TrialEnd, path: Path, sha256: bytes, steps: int
) -> float:
    """Return the sum of rewards of a trial.

    Raises:
        Mismatch: something does not match.
        GlueError: the record cannot be read, or the environment cannot be made.
    """
    if sha256 != outcome.digest:
        raise Mismatch(f"{path} is not the record that was finished: bytes in it were changed")
    episodes, score = replay_trial(spec, path)
    _compare_episodes(results.episodes(spec.id), episodes)
    ends = [end for end, *_ in episodes]
    if outcome.reason is None:
        total = sum(count for _, count, *_ in episodes)
        whole = len(ends) == spec.episodes and Ending.VOID not in ends
        complete = total == steps if steps else whole
        if not complete:
            raise Mismatch(
                f"it was not played to the end: the record has {len(ends)} episodes, {total} steps"
            )
    return score


Replayed = tuple[Ending, int, float, int]
"""The ending of an episode, its number of steps, its return, and the number of late actions."""


def replay_trial(spec: TrialSpec, path: Path) -> tuple[list[Replayed], float]:
    """Play a record again; return its episodes, and the sum of all rewards.

    Raises:
        Mismatch: the record is not of this trial, or a reward or the end of an episode differs.
        TrajectoryError: the record is damaged.
    """
    replay, task_spec = replay_of(spec)
    run = without_places(run_of(spec, task_spec))
    episodes: list[Replayed] = []
    score = 0.0
    reader = TrajectoryReader(path)
    for number, episode in enumerate(reader, 1):
        if without_places(episode.run) != run or not isinstance(episode.steps, ActionSteps):
            raise Mismatch(f"{path} is not a record of {spec.id}: it is of {_shown(episode.run)}")
        replay.start()
        count, total = 0, 0.0
        for rewards in _replayed(replay, episode, number):
            count += len(rewards)
            total, score = _add(total, rewards), _add(score, rewards)
        episodes.append((episode.ending, count, total, len(episode.late)))
    if reader.torn:
        raise Mismatch(f"the record ends in the middle of episode {len(episodes) + 1}")
    return episodes, score


def _replayed(replay: Replay, episode: Episode, number: int) -> Iterator[npt.NDArray[np.float64]]:
    """Yield the rewards of each block of an episode, once they have been compared."""
    assert isinstance(episode.steps, ActionSteps)
    blocks = episode.steps.blocks
    before = 0
    for block in blocks:
        actions = _actions(block.actions)
        rewards, ended = replay.play(actions, block.choices.astype(np.int64))
        # An environment may cut an episode off itself, or be cut off.
        terminal: bool | None = False
        if block is blocks[-1]:
            terminal = None if episode.ending is Ending.CUTOFF else episode.ending is Ending.TERMINAL
        if (difference := compare(Outcomes(block.rewards, terminal), Outcomes(rewards, ended))) is not None:
            step, how = difference
            raise Mismatch(f"episode {number}, step {before + step + 1}: {how}")
        before += len(rewards)
        yield rewards


@lru_cache(maxsize=1)
def _actions(bodies: tuple[bytes, ...]) -> list[Action]:
    """Return actions from their bodies; consecutive episodes often have the same ones."""
    return [Action.from_body(body) for body in bodies]


def _shown(run: Run) -> str:
    return f"{run.environment} with {dict(run.options)!r:.200} and seed {run.seed}"


def _compare_episodes(stored: Sequence[EpisodeResult], replayed: Sequence[Replayed]) -> None:
    whole = [episode for episode in replayed if episode[0] is not Ending.VOID]
    if len(stored) != len(whole):
        raise Mismatch(f"the record has {len(whole)} episodes, and the database {len(stored)}")
    for row, (end, count, total, late) in zip(stored, whole, strict=True):
        terminal = end is Ending.TERMINAL
        # RL_num_steps counts observations, of which the last step of an episode has none.
        expected = (total, count if terminal else count + 1, terminal, late)
        # Results from before there was a rate do not know how many were late.
        found = (row.episode_return, row.steps, row.terminal, late if math.isnan(row.late) else row.late)
        if found != expected:
            raise Mismatch(f"episode {row.episode} is {expected} by its record, and {found} in the database")


def _add(total: float, rewards: npt.NDArray[np.float64]) -> float:
    """Return the sum, added up one by one as in a trial: the last bits depend on the order."""
    return float(np.add.accumulate(np.concatenate(([total], rewards)))[-1])
