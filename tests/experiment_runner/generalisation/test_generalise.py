"""glue-generalise: what is played, what is scored, and what the table says."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner

from env_server.mario import InfiniteMario
from env_server.mario.level_sets import LEVEL_SETS, level_seed, numbered_level, resolve_levels
from experiment_runner.generalisation.command import generalise
from experiment_runner.generalisation.evaluation import evaluate
from experiment_runner.generalisation.summary import summarise, table
from glue import Action, Observation, make_agent
from glue.errors import ConfigError

TASK = InfiniteMario().parameters


def test_a_set_of_levels_never_changes() -> None:
    """These numbers are part of every published result; see VERSION in env_server/mario/level_sets.py."""
    levels = [numbered_level(TASK, n) for n in (0, 1, 5, 199, 499, 1_000_000, 1_000_999)]
    assert [(level.level_seed, level.level_type, level.level_difficulty) for level in levels] == [
        (1896895516, 0, 0),
        (926699317, 1, 0),
        (702926726, 2, 1),
        (518638806, 1, 2),
        (537139325, 1, 2),
        (1728834397, 1, 1),
        (1932614524, 1, 2),
    ]


def test_sets_hold_all_types_and_difficulties_and_do_not_meet() -> None:
    train, more, test = (LEVEL_SETS[name] for name in ("train-200", "train-500", "test-1000"))
    assert (len(train), len(more), len(test)) == (200, 500, 1000)
    assert set(train) < set(more)
    assert not set(more) & set(test)
    for levels in (train, more, test):
        tasks = [numbered_level(TASK, number) for number in levels]
        kinds = {(task.level_type, task.level_difficulty) for task in tasks}
        assert kinds == {(kind, difficulty) for kind in range(3) for difficulty in range(4)}
        assert len({task.level_seed for task in tasks}) == len(levels)
    assert resolve_levels(None, 3, 7) == range(7, 10)


def test_neighbouring_levels_have_seeds_far_apart() -> None:
    seeds = np.array([level_seed(number) for number in range(1000)])
    assert abs(np.corrcoef(seeds[1:], seeds[:-1])[0, 1]) < 0.1
    assert np.abs(np.diff(seeds)).min() > 1000
    assert abs(seeds.mean() / 2**30 - 1) < 0.1


class Learner:
    """Runs to the right; remembers how many episodes it has played, and every level it was loaded for."""

    def __init__(self) -> None:
        self.played = 0
        self.at_load: list[int] = []

    def agent_init(self, task_spec: str) -> None:
        self.played = 0

    def agent_start(self, observation: Observation) -> Action:
        self.played += 1
        return Action([1, 1, 1])

    def agent_step(self, reward: float, observation: Observation) -> Action:
        return Action([1, 1, 1])

    def agent_end(self, reward: float) -> None:
        pass

    def agent_cleanup(self) -> None:
        pass

    def agent_message(self, message: str) -> str:
        return ""

    def agent_save(self) -> bytes:
        return bytes([self.played])

    def agent_load(self, data: bytes) -> None:
        self.at_load.append(self.played)
        self.played = data[0]


def test_every_level_is_scored_from_what_was_learned_on_the_training_levels() -> None:
    agent = Learner()
    result = evaluate(agent, 1, range(4), range(1_000_000, 1_000_003), learn=5, relearn=2)
    assert agent.at_load == [5] + [5 + 2 + 1] * 6
    assert [score.level for score in result.train] == [0, 1, 2, 3]
    assert [score.level for score in result.test] == [1_000_000, 1_000_001, 1_000_002]
    again = evaluate(Learner(), 1, range(4), range(1_000_000, 1_000_003))
    assert (again.train, again.test) == (result.train, result.test)


def test_scores_are_those_of_the_level() -> None:
    result = evaluate(make_agent("run-right"), 1, range(12), range(0))
    for score in result.train:
        task = numbered_level(TASK, score.level)
        mario = InfiniteMario(
            level_seed=task.level_seed, level_type=task.level_type, level_difficulty=task.level_difficulty
        )
        mario.env_init()
        mario.env_start()
        total, reward, terminal, steps = 0.0, 0.0, False, 0
        while not terminal:
            reward, _, terminal = mario.env_step(Action([1, 1, 1]))
            total += reward
            steps += 1
        assert (score.episode_return, score.goal, score.steps) == (total, reward == 100.0, steps)


def document(train: Iterable[Iterable[float]], test: Iterable[Iterable[float]]) -> dict[str, Any]:
    def scores(returns: Iterable[float]) -> list[dict[str, Any]]:
        return [{"episode_return": value, "goal": value > 50} for value in returns]

    trials = [{"train": scores(a), "test": scores(b)} for a, b in zip(train, test, strict=True)]
    return {"name": "someone", "trials": trials}


def test_summary_is_as_rliable_defines_it() -> None:
    rng = np.random.default_rng(3)
    train, test = rng.normal(60, 10, (3, 8)), rng.normal(20, 10, (3, 8))
    summary = summarise(document(train, test))
    middle = np.sort(test.ravel())[6:18]  # a quarter of 24 is trimmed at either end
    assert summary.episode_return[1].value == pytest.approx(middle.mean())
    assert summary.goal_rate[0].value == pytest.approx((train > 50).mean())
    assert summary.goal_rate[2].value == pytest.approx((train > 50).mean() - (test > 50).mean())
    for interval in (*summary.goal_rate, *summary.episode_return):
        assert interval.low <= interval.value <= interval.high
    assert summary.episode_return[2].low > 20
    # Trials that agree leave no doubt about a level.
    same = summarise(document([train[0]] * 3, [test[0]] * 3)).episode_return[0]
    assert same.low == same.value == same.high
    alone = summarise(document([train[0]], [test[0]])).episode_return[0]
    assert alone.low < alone.value < alone.high


def test_command_plays_writes_and_shows(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(LEVEL_SETS, "train-200", range(3))
    monkeypatch.setitem(LEVEL_SETS, "test-1000", range(50, 54))
    out = tmp_path / "random.json"
    given = ["--agent", "random", "--agent-option", "seed={seed}", "--seed", "4", "--seed", "5"]
    first = CliRunner().invoke(generalise, [*given, "--out", str(out)], catch_exceptions=False)
    assert first.exit_code == 0, first.output
    assert f"wrote {out}" in first.output
    result = json.loads(out.read_text())
    assert [trial["seed"] for trial in result["trials"]] == [4, 5]
    assert [len(trial["test"]) for trial in result["trials"]] == [4, 4]
    shown = CliRunner().invoke(generalise, ["--table", str(out), "--table", str(out)])
    assert shown.output == table([result, result]) + "\n"
    assert shown.output.count("| random | 2 |") == 2
    again = CliRunner().invoke(generalise, given, catch_exceptions=False)
    assert table([result]) in again.output, "the same seeds, the same scores"


def test_file_that_cannot_be_written_is_refused_before_anything_is_played(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    result = CliRunner().invoke(generalise, ["--agent", "random", "--out", str(tmp_path / "file" / "a.json")])
    assert isinstance(result.exception, ConfigError)
    assert "cannot write" in str(result.exception)


def test_what_is_no_result_is_refused(tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.json"
    wrong.write_text("{}")
    outcome = CliRunner().invoke(generalise, ["--table", str(wrong)])
    assert isinstance(outcome.exception, ConfigError)
    assert CliRunner().invoke(generalise, []).exit_code == 2
    outcome = CliRunner().invoke(generalise, ["--agent", "random", "--train", "train-2"])
    assert "train-200" in str(outcome.exception)
