"""glue-generalise: its play, its scores and its table."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from agents.mario.runner import RunRightAgent
from env_server.mario import InfiniteMario
from env_server.mario.level_sets import LEVEL_SETS, LevelFolder, LevelSet, resolve_levels
from experiment_runner.cli.generalise import generalise
from experiment_runner.store.database import StorageError
from experiment_runner.study.generalisation.players import (
    LAST_REWARD,
    NumberedLevels,
    SetBack,
    level_set,
    set_name,
)
from experiment_runner.study.generalisation.summary import summarise, table
from glue import Action, Agent, ConfigError, Experiment, ExperimentError, Observation, local
from glue.engine.local import LocalExperiment

TASK = InfiniteMario().parameters


def test_a_set_of_levels_never_changes() -> None:
    """These numbers are part of every published result; see VERSION in env_server/mario/level_sets.py."""
    first, last = LEVEL_SETS["train-500"], LEVEL_SETS["ladder-v1"]
    levels = [first.level(TASK, n) for n in (0, 1, 5, 199, 499, 1_000_000, 1_000_999)]
    levels += [last.level(TASK, n) for n in (2_000_000, 2_016_031)]
    assert [(level.level_seed, level.level_type, level.level_difficulty) for level in levels] == [
        (1896895516, 0, 0),
        (926699317, 1, 0),
        (702926726, 2, 1),
        (518638806, 1, 2),
        (537139325, 1, 2),
        (1728834397, 1, 1),
        (1932614524, 1, 2),
        (1115779264, 2, 10),
        (1545612110, 1, 10),
    ]


def test_sets_hold_all_types_and_difficulties_and_do_not_meet() -> None:
    names = ("train-200", "train-500", "test-1000", "ladder-v1")
    train, more, test, ladder = (set(LEVEL_SETS[name].numbers) for name in names)
    assert [len(levels) for levels in (train, more, test, ladder)] == [200, 500, 1000, 16_032]
    assert train < more
    assert not more & test
    assert not (more | test) & ladder
    for levels in LEVEL_SETS.values():
        tasks = [levels.level(TASK, number) for number in levels.numbers]
        kinds = Counter((task.level_type, task.level_difficulty) for task in tasks)
        assert kinds.keys() == {(kind, level) for kind in range(3) for level in range(levels.difficulties)}
        assert max(kinds.values()) - min(kinds.values()) <= 1
    assert resolve_levels(None, 3, 7) == (range(7, 10), 4)


def test_first_levels_of_a_set() -> None:
    assert level_set("test-1000:10").numbers == range(1_000_000, 1_000_010)
    ladder = level_set("ladder-v1:3")
    assert isinstance(ladder, LevelSet)
    assert ladder.difficulties == 16
    for wrong in ("test-1000:0", "test-1000:1001", "test-1000:-1", "test-1000:", "test-1000:x"):
        with pytest.raises(ConfigError):
            level_set(wrong)


class Learner(Agent):
    """Runs to the right, jumping in every other episode; answers with its number of episodes at each load."""

    def __init__(self) -> None:
        self.played = 0
        self.at_load: list[int] = []

    def agent_init(self, task_spec: str) -> None:
        self.played = 0

    def agent_start(self, observation: Observation) -> Action:
        self.played += 1
        return self.agent_step(0.0, observation)

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return Action([1, self.played % 2, 1])

    def agent_message(self, message: str) -> str:
        return str(self.at_load)

    def agent_save(self) -> bytes:
        return bytes([self.played])

    def agent_load(self, data: bytes) -> None:
        self.at_load.append(self.played)
        self.played = data[0]


@pytest.fixture
def few_levels(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(LEVEL_SETS, "few", LevelSet(range(4)))
    monkeypatch.setitem(LEVEL_SETS, "unseen", LevelSet(range(1_000_000, 1_000_003)))


def players(learn: int, relearn: int) -> LocalExperiment:
    """Return an experiment that has begun, with both players of a benchmark of seven levels."""
    agent = SetBack(agent=f"{__file__}:Learner", learn=learn, relearn=relearn)
    levels = NumberedLevels(train="few", sets="few,unseen", learn=learn, relearn=relearn, seed=1)
    glue = local(agent, levels)
    glue.rl_init(1)
    return glue


def episodes(glue: Experiment, count: int) -> list[tuple[str, int, float, str]]:
    """Play; return the level, steps, return and last reward of each episode."""
    played = []
    for _ in range(count):
        glue.rl_episode()
        results = (glue.rl_num_steps(), glue.rl_return(), glue.rl_agent_message(LAST_REWARD))
        played.append((glue.rl_env_message("level"), *results))
    return played


@pytest.mark.usefixtures("few_levels")
def test_every_level_is_scored_from_what_was_learned_on_the_training_levels() -> None:
    with players(learn=5, relearn=2) as glue:
        scored = episodes(glue, 5 + 7 * 3)[5 + 2 :: 3]
        assert glue.rl_agent_message("at load") == str([5] + [5 + 2 + 1] * 6)
    task = LEVEL_SETS["few"].level(TASK, 1)
    assert scored[1][0] == (
        f"level_seed={task.level_seed} level_type={task.level_type} level_difficulty={task.level_difficulty}"
    )
    assert len({level for level, *_ in scored}) == 7


@pytest.mark.usefixtures("few_levels")
def test_a_benchmark_continues_from_what_both_players_have_saved() -> None:
    with players(learn=5, relearn=1) as glue:
        whole = episodes(glue, 19)
    for at in (0, 2, 5, 6, 9, 18):
        with players(learn=5, relearn=1) as glue:
            first = episodes(glue, at)
            saved = glue.rl_env_save(), glue.rl_agent_save()
        with players(learn=5, relearn=1) as glue:
            glue.rl_env_load(saved[0])
            glue.rl_agent_load(saved[1])
            assert first + episodes(glue, 19 - at) == whole


def test_levels_in_the_files_of_a_folder_are_a_set(tmp_path: Path) -> None:
    folder, out = tmp_path / "week#1:2", tmp_path / "scores.json"
    folder.mkdir()
    flat, wall = "X" * 30, ("-" * 20 + "#" + "-" * 9 + "\n") * 14 + "X" * 30
    (folder / "wall.txt").write_text(wall)
    (folder / "flat.txt").write_text(flat)
    arguments = ["--agent", "run-right", "--set", str(folder), "--seed", "1", "--out", str(out)]
    done = CliRunner().invoke(generalise, arguments, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    document = json.loads(out.read_text())
    [name] = document["sets"]
    levels = level_set(name)
    assert isinstance(levels, LevelFolder)
    assert [levels.title(number) for number in levels.numbers] == ["flat.txt", "wall.txt"]
    assert [score["goal"] for score in document["trials"][0][name]] == [True, False]
    assert CliRunner().invoke(generalise, ["verify", str(out)]).exit_code == 0
    (folder / "flat.txt").write_text(wall)
    with pytest.raises(ExperimentError, match=r"flat\.txt has changed since"):
        CliRunner().invoke(generalise, arguments, catch_exceptions=False)
    with pytest.raises(ConfigError, match="have changed: their digest is"):
        CliRunner().invoke(generalise, ["verify", str(out)], catch_exceptions=False)
    with pytest.raises(ConfigError, match=r"has 0 levels \*\.txt: expected 1 to 10000"):
        level_set(str(tmp_path))
    with pytest.raises(ConfigError, match="is neither a folder of levels nor a set of them; choose from"):
        level_set(str(folder / "flat.txt"))
    (folder / "flat.txt").write_text("hello")
    with pytest.raises(ConfigError, match=r"flat\.txt, line 1, column 6: "):
        set_name(str(folder))


def test_scores_are_those_of_the_level(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(LEVEL_SETS, "few", LevelSet(range(12)))
    out = tmp_path / "scores.json"
    arguments = ["--agent", "run-right", "--set", "few", "--seed", "1", "--ask", "x", "--out", str(out)]
    done = CliRunner().invoke(generalise, arguments, catch_exceptions=False)
    assert done.exit_code == 0, done.output
    [trial] = json.loads(out.read_text())["trials"]
    assert [score["level"] for score in trial["few"]] == list(range(12))
    for score in trial["few"]:
        task = LEVEL_SETS["few"].level(TASK, score["level"])
        glue = local(RunRightAgent(), InfiniteMario(**asdict(task)))
        glue.rl_init()
        glue.rl_episode()
        played = glue.rl_return(), glue.rl_return() > 50, glue.rl_num_steps()
        assert (score["episode_return"], score["goal"], score["steps"]) == played
        assert score["difficulty"] == task.level_difficulty
    rows = [line.split(" | ") for line in done.stdout.splitlines()[2:]]
    assert [row[2:5] for row in rows] == [[d, "3", "1"] for d in "0123"] + [["all", "12", "1"]]


def document(train: Iterable[Iterable[float]], test: Iterable[Iterable[float]]) -> dict[str, Any]:
    def scores(returns: Iterable[float]) -> list[dict[str, Any]]:
        return [{"episode_return": value, "goal": value > 50} for value in returns]

    trials = [{"train": scores(a), "test": scores(b)} for a, b in zip(train, test, strict=True)]
    return {"name": "someone", "trials": trials}


def test_summary_is_as_rliable_defines_it() -> None:
    rng = np.random.default_rng(3)
    train, test = rng.normal(60, 10, (3, 8)), rng.normal(20, 10, (3, 8))
    summary = summarise(document(train, test))
    middle = np.sort(test.ravel())[6:18]  # a quarter of 24 is trimmed at each end
    assert summary[4].value == pytest.approx(middle.mean())
    assert summary[0].value == pytest.approx((train > 50).mean())
    assert summary[2].value == pytest.approx((train > 50).mean() - (test > 50).mean())
    for interval in summary:
        assert interval.low <= interval.value <= interval.high
    assert summary[5].low > 20
    # Trials that agree leave no uncertainty about a level.
    same = summarise(document([train[0]] * 3, [test[0]] * 3))[3]
    assert same.low == same.value == same.high
    alone = summarise(document([train[0]], [test[0]]))[3]
    assert alone.low < alone.value < alone.high


@pytest.fixture
def small_sets(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(LEVEL_SETS, "train-200", LevelSet(range(3)))
    monkeypatch.setitem(LEVEL_SETS, "test-1000", LevelSet(range(50, 54)))


@pytest.mark.usefixtures("small_sets")
def test_command_plays_writes_and_shows(tmp_path: Path) -> None:
    out = tmp_path / "random.json"
    given = ["--agent", "random", "--agent-option", "seed={seed}", "--seed", "4", "--seed", "5"]
    first = CliRunner().invoke(generalise, [*given, "--out", str(out)], catch_exceptions=False)
    assert first.exit_code == 0, first.output
    assert f"wrote {out}" in first.output
    result = json.loads(out.read_text())
    assert [trial["seed"] for trial in result["trials"]] == [4, 5]
    assert [len(trial["test"]) for trial in result["trials"]] == [4, 4]
    # The file and the run agree; the finished run is not played again.
    shown = CliRunner().invoke(generalise, ["--table", str(out), "--table", str(tmp_path / "random")])
    assert shown.output == table([result, result]) + "\n"
    assert shown.output.count("| random | 2 |") == 2
    again = CliRunner().invoke(generalise, [*given, "--out", str(out)], catch_exceptions=False)
    assert table([result]) in again.output
    assert json.loads(out.read_text()) == result
    other = CliRunner().invoke(generalise, [*given, "--learn", "1", "--out", str(out)])
    assert isinstance(other.exception, ExperimentError)
    assert "learn is 0" in str(other.exception)


@pytest.mark.usefixtures("small_sets")
def test_results_with_different_tables_are_not_mixed(tmp_path: Path) -> None:
    files = [str(tmp_path / "gap"), str(tmp_path / "set")]
    for file, options in zip(files, ([], ["--set", "train-200"]), strict=True):
        done = CliRunner().invoke(generalise, ["--agent", "run-right", *options, "--out", file])
        assert done.exit_code == 0
    mixed = CliRunner().invoke(generalise, ["--table", files[0], "--table", files[1]])
    assert isinstance(mixed.exception, ConfigError)


def test_file_that_cannot_be_written_is_refused_before_anything_is_played(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    result = CliRunner().invoke(generalise, ["--agent", "random", "--out", str(tmp_path / "file" / "a.json")])
    assert isinstance(result.exception, StorageError)


def test_what_is_no_result_is_refused(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.json"
    wrong.write_text("{}")
    outcome = CliRunner().invoke(generalise, ["--table", str(wrong)])
    assert isinstance(outcome.exception, ConfigError)
    assert CliRunner().invoke(generalise, []).exit_code == 2
    outcome = CliRunner().invoke(generalise, ["--agent", "random", "--train", "train-2"])
    assert "train-200" in str(outcome.exception)
