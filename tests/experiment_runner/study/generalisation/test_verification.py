"""Scores verified by replay, files of scores, and noise."""

from __future__ import annotations

import copy
import gzip
import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from env_server.mario.level_sets import LEVEL_SETS, LevelSet
from experiment_runner.cli.generalise import generalise
from experiment_runner.study.generalisation import benchmark
from experiment_runner.study.generalisation.benchmark import read_scores
from experiment_runner.study.generalisation.players import ACTIONS, Noise, digit_of
from experiment_runner.study.generalisation.summary import table
from experiment_runner.study.generalisation.verification import differences
from glue import Action, ConfigError


@pytest.fixture
def few(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(LEVEL_SETS, "few", LevelSet(range(3)))


def wrong(document: dict[str, Any]) -> list[str]:
    return list(differences(document, lambda line: None))


@pytest.mark.usefixtures("few")
@pytest.mark.parametrize("options", [[], ["--noise", "0.2", "--relearn", "1"]], ids=["still", "noisy"])
def test_scores_of_a_run_are_what_their_actions_earn(tmp_path: Path, options: list[str]) -> None:
    out = tmp_path / "scores.json"
    given = ["--agent", "sample", "--set", "few", "--seed", "1", "--seed", "2", *options, "--out", str(out)]
    assert CliRunner().invoke(generalise, given, catch_exceptions=False).exit_code == 0
    result = json.loads(out.read_text())
    assert not wrong(result)
    assert CliRunner().invoke(generalise, ["verify", str(tmp_path / "scores")]).exit_code == 0
    unplayed = {"actions": "", "sims": 1, "goal": False}
    for change in (
        *({"episode_return": 1000.0}, {"goal": None}, {"actions": "0"}, {"steps": 1}, {"difficulty": 3}),
        *({"actions": "0", "steps": 1, "goal": False, "episode_return": 0.0}, unplayed),
    ):
        forged = copy.deepcopy(result)
        forged["trials"][1]["few"][2] |= change
        assert len(wrong(forged)) == 1, change
    forged = copy.deepcopy(result)
    forged["trials"][1]["few"][2] = forged["trials"][1]["few"][1]
    said: list[str] = []
    assert len([*differences(forged, said.append)]) == 1
    assert said[0] == "1 of 3 levels of few have no episode, seed 2"
    forged["trials"][1] = forged["trials"][0]
    assert len(wrong(forged)) == 3
    if options:
        result["noise"] = 0.0
        assert wrong(result)


@pytest.mark.usefixtures("few")
def test_what_cannot_be_replayed_is_refused() -> None:
    score = {"level": 0, "goal": False, "episode_return": 0.0, "actions": "0"}
    document = {
        "sets": ["few"],
        "relearn": 0,
        "trials": [{"seed": 1, "level_sets_version": 1, "few": [score]}],
    }
    for change in ({"level": 3}, {"level": "x"}, {"level": None}):
        score.update(change)
        with pytest.raises(ConfigError):
            wrong(document)
    for broken in ({}, {**document, "trials": [{}]}, {**document, "sets": ["nothing"]}):
        with pytest.raises(ConfigError):
            wrong(broken)
    score.update(level=0, actions="x", difficulty=0, steps=1)
    assert wrong(document)


def test_a_compressed_file_is_read_and_a_bomb_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "scores.json.gz"
    scores = {"name": "someone", "sets": [], "train": "", "test": "", "relearn": 0, "trials": []}
    file.write_bytes(gzip.compress(json.dumps(scores).encode()))
    assert read_scores(file) == scores
    monkeypatch.setattr(benchmark, "_MOST_BYTES", 2**20)
    file.write_bytes(gzip.compress(bytes(2**20 + 1)))
    with pytest.raises(ConfigError, match="longer than"):
        read_scores(file)


@pytest.mark.parametrize("text", ["null", "[]", "3", "{}", '"name trials"', "[" * 100_000])
def test_json_that_is_no_score_is_refused(tmp_path: Path, text: str) -> None:
    for file in (tmp_path / "scores.json", tmp_path / benchmark.BENCHMARK_FILE):
        file.write_text(text)
    for path in (tmp_path / "scores.json", tmp_path):
        with pytest.raises(ConfigError, match=r"is not a (result|run) of glue-generalise"):
            read_scores(path)


@pytest.mark.parametrize("sets", [[], ["few"]])
@pytest.mark.parametrize("trial", [3, {}, {"few": None}, {"few": [3]}, {"few": [{"difficulty": 0}]}])
def test_scores_without_their_fields_have_no_table(sets: list[str], trial: object) -> None:
    with pytest.raises(ConfigError, match="these are not scores of glue-generalise"):
        table([{"name": "someone", "sets": sets, "questions": [], "trials": [trial]}])


def test_noise_replaces_the_given_share_of_actions_and_is_repeatable() -> None:
    action = Action(ints=[1, 0, 1])
    first, again, other = (Noise(0.2, seed, 7, 0) for seed in (1, 1, 2))
    made = [digit_of(first(action)) for _ in range(5000)]
    assert made == [digit_of(again(action)) for _ in range(5000)]
    assert made != [digit_of(other(action)) for _ in range(5000)]
    assert set(made) == ACTIONS.keys()
    assert 0.15 < sum(digit != digit_of(action) for digit in made) / len(made) < 0.22
    assert all(Noise(0, 1, 7, 0)(action) is action for _ in range(10))
