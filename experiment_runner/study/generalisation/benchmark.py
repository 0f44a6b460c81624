"""A benchmark of generalisation as trials of a run, and the scores in that run.

A trial plays every level of the scored sets with one seed. If nothing is learned before, and there are scores
for each difficulty, it plays only the levels of one difficulty, so that workers can share a set.
"""

from __future__ import annotations

import gzip
import json
import zlib
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

from env_server.mario import InfiniteMario
from env_server.mario.level_sets import VERSION, LevelFolder
from experiment_runner.executors.opening import Definition, open_run
from experiment_runner.plan.limits import TrialId
from experiment_runner.plan.plan import RoleSpec, RoleSweep, TrialSpec
from experiment_runner.store.results import Results
from experiment_runner.store.store import Store
from experiment_runner.study.generalisation.players import (
    LAST_ACTIONS,
    LAST_REWARD,
    NumberedLevels,
    SetBack,
    level_set,
    scored_levels,
)
from experiment_runner.study.generalisation.summary import Document
from glue.errors import ConfigError, ExperimentError
from glue.files import read_text
from glue.options import parse_assignments
from glue.plugins.loading import find
from glue.wire.messages import Role

BENCHMARK_FILE: Final = "generalisation.json"
"""File of a run directory: its benchmark, and the version of the sets."""

_MOST_BYTES: Final = 2**28
"""Maximum size of a file of scores, in bytes; the scores of 16,032 levels take 5 MB."""

_GOAL: Final = InfiniteMario().parameters.reward_goal


@dataclass(frozen=True, slots=True)
class Benchmark:
    """An agent, and the levels on which it learns and is scored.

    Args:
        name: the agent's name in tables.
        agent: the agent, as `glue.plugins.loading.find` takes it.
        agent_options: its options as NAME=VALUE; `{seed}` in one becomes the seed of the trial.
        train: set of the levels for learning.
        test: set of unseen levels; this set and `train` are scored.
        sets: sets to score instead, for each difficulty.
        learn: number of episodes of learning.
        relearn: number of episodes on a level before the scored one.
        seeds: one for each trial of a level.
        questions: messages sent to the agent after each episode.
        noise: probability that an action is replaced by a random one.

    Raises:
        ConfigError: a set or an agent is unknown, or an option is wrong.
    """

    name: str
    agent: str
    agent_options: tuple[str, ...] = ()
    train: str = "train-200"
    test: str = "test-1000"
    sets: tuple[str, ...] = ()
    learn: int = 0
    relearn: int = 0
    seeds: tuple[int, ...] = (1, 2, 3)
    questions: tuple[str, ...] = ()
    noise: float = 0.0

    @property
    def columns(self) -> dict[str, str]:
        """The names of the scored sets, in order, by their keys in a document."""
        return {name: name for name in self.sets} or {"train": self.train, "test": self.test}

    def dump(self) -> str:
        """Return the contents of `BENCHMARK_FILE`."""
        return json.dumps({**asdict(self), "level_sets_version": VERSION}, indent=2) + "\n"

    def trials(self) -> list[TrialSpec]:
        """Return the trials of the run."""
        joined = ",".join(self.columns.values())
        parts = [-1]
        if self.sets and not self.learn:
            parts = sorted({levels.difficulty(number) for levels, number in scored_levels(joined)})
        return [self._trial(joined, part, seed) for part in parts for seed in self.seeds]

    def player(self, seed: int) -> RoleSpec:
        """Return the agent and its options for a seed.

        Raises:
            ConfigError: the agent is unknown, or an option is wrong.
        """
        given = [option.replace("{seed}", str(seed)) for option in self.agent_options]
        options = parse_assignments(find(Role.AGENT, self.agent), given)
        source, _, attribute = self.agent.rpartition(":")
        name = f"{Path(source).absolute()}:{attribute}" if source.endswith(".py") else self.agent
        return RoleSpec(name, options, RoleSpec(self.agent).label)

    def _trial(self, sets: str, part: int, seed: int) -> TrialSpec:
        player = self.player(seed)
        given = {"agent": player.name, "options": json.dumps(dict(player.options))}
        label = player.label
        counts = {"learn": self.learn, "relearn": self.relearn}
        where = sets.replace(",", "+").replace("/", "-") + ("" if part < 0 else f"/difficulty={part}")
        blocks = len(scored_levels(sets, part))
        noise = {"noise": self.noise} if self.noise else {}
        return TrialSpec(
            id=TrialId.of(label, where, seed),
            agent=RoleSpec(_path(SetBack), {**given, **counts}, label),
            environment=RoleSpec(
                _path(NumberedLevels),
                {"train": self.train, "sets": sets, "difficulty": part, "seed": seed, **counts, **noise},
                where,
            ),
            episodes=self.learn + blocks * (self.relearn + 1),
            max_steps=0,
            seed=seed,
        )


def benchmark_of(directory: Path) -> Benchmark:
    """Return the benchmark of a run.

    Raises:
        ConfigError: the directory is not a run of `glue-generalise`.
    """
    try:
        fields = json.loads(read_text(directory / BENCHMARK_FILE))
        if fields.pop("level_sets_version") != VERSION:
            raise ValueError("its sets of levels are of another version")
        lists = ("agent_options", "sets", "seeds", "questions")
        return Benchmark(**{**fields, **{name: tuple(fields[name]) for name in lists}})
    except (OSError, ValueError, TypeError, KeyError, AttributeError, RecursionError) as error:
        raise ConfigError(f"{directory} is not a run of glue-generalise: {error}") from None


def read_scores(path: Path) -> Document:
    """Return the scores in a run, or in a file that `--out` or `studies.certificates` wrote.

    Raises:
        ConfigError: there are none.
        ExperimentError: the run is not finished, or cannot be read.
    """
    if path.is_dir():
        benchmark = benchmark_of(path)
        with Results.open(path) as results:
            return document(results, benchmark)
    try:
        with (gzip.open if path.suffix == ".gz" else open)(path, "rb") as file:
            text = file.read(_MOST_BYTES + 1)
        if len(text) > _MOST_BYTES:
            raise ValueError(f"it is longer than {_MOST_BYTES} bytes")
        scores: Any = json.loads(text)
        names = ("name", "trials")
        if not isinstance(scores, dict) or not all(name in scores for name in names):
            raise ValueError(f"it has no {' or '.join(names)}")
    except (OSError, EOFError, zlib.error, ValueError, RecursionError) as error:
        raise ConfigError(f"{path} is not a result of glue-generalise: {error}") from None
    return scores


def open_benchmark(directory: Path, benchmark: Benchmark, say: Callable[[str], None]) -> Store:
    """Return the store of a benchmark's run: a new one, or the one in the directory, prepared to continue.

    Args:
        directory: contains the run, or will contain it.
        benchmark: of the run.
        say: shows a line about each interrupted trial.

    Raises:
        ConfigError: the directory is not a run of `glue-generalise`.
        ExperimentError: the run is of another benchmark, or of the file of an agent or a level that has
            changed since, is in use, or cannot be written to.
    """

    def check(store: Store) -> None:
        recorded, wanted = (asdict(one) for one in (benchmark_of(directory), benchmark))
        changed = [f"{name} is {recorded[name]}" for name in wanted if recorded[name] != wanted[name]]
        if changed or [record.spec for record in store.trials()] != specs:
            raise ExperimentError(f"{directory} is the run of another benchmark ({'; '.join(changed)})")

    specs, files = benchmark.trials(), {BENCHMARK_FILE: benchmark.dump()}
    players: list[RoleSpec | RoleSweep] = [benchmark.player(seed) for seed in benchmark.seeds]
    sets = map(level_set, dict.fromkeys([benchmark.train, *benchmark.columns.values()]))
    for levels in sets:
        if isinstance(levels, LevelFolder):
            players.append(RoleSweep("mario", {"level": tuple(str(path) for path, _ in levels.files)}))
    return open_run(directory, Definition(specs, files, players, check), say=say)


def document(results: Results, benchmark: Benchmark) -> Document:
    """Return the scores of a finished run, as `glue-generalise --out FILE.json` writes them.

    Raises:
        ExperimentError: the run is not finished, or cannot be read.
    """
    trials: dict[int, dict[str, Any]] = {
        seed: {
            "seed": seed,
            **{name: [] for name in benchmark.columns},
            "learning_seconds": 0.0,
            "scoring_seconds": 0.0,
            "level_sets_version": VERSION,
        }
        for seed in benchmark.seeds
    }
    for record in results.trials():
        spec = record.spec
        if not record.finished:
            why = record.failure or f"{record.done} of {spec.episodes} episodes are done"
            raise ExperimentError(f"{spec.id} is not finished: {why}")
        _add(trials[spec.seed], spec, results, benchmark)
    for trial in trials.values():
        for name in benchmark.columns:
            trial[name].sort(key=lambda score: score["level"])
    fields = asdict(benchmark)
    del fields["seeds"]
    return {**fields, "trials": list(trials.values())}


def _add(trial: dict[str, Any], spec: TrialSpec, results: Results, benchmark: Benchmark) -> None:
    """Add the scores of a trial of the run to those of its seed."""
    assert spec.environment is not None
    part = int(spec.environment.options["difficulty"])
    episodes = results.episodes(spec.id)
    trial["learning_seconds"] += sum(episode.wall_time for episode in episodes[: benchmark.learn])
    trial["scoring_seconds"] += sum(episode.wall_time for episode in episodes[benchmark.learn :])
    answers: dict[int, dict[str, str]] = {}
    for one in results.answers(spec.id):
        answers.setdefault(one.episode, {})[one.message] = one.answer
    blocks = iter(episodes[benchmark.learn + benchmark.relearn :: benchmark.relearn + 1])
    for column, name in benchmark.columns.items():
        for (levels, number), episode in zip(scored_levels(name, part), blocks, strict=False):
            answered = answers[episode.episode]
            trial[column].append(
                {
                    "level": number,
                    "difficulty": levels.difficulty(number),
                    "episode_return": episode.episode_return,
                    "goal": float(answered.pop(LAST_REWARD)) == _GOAL,
                    "steps": episode.steps,
                    "seconds": episode.wall_time,
                    "actions": answered.pop(LAST_ACTIONS, ""),
                    "answers": answered,
                }
            )


def _path(factory: type) -> str:
    return f"{factory.__module__}:{factory.__name__}"
