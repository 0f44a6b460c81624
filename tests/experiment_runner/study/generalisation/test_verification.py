"""Scores verified by replay, certificates, noise, and the study of unknown constants."""

from __future__ import annotations

import copy
import gzip
import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from env_server.mario.level_sets import LEVEL_SETS, LevelSet
from experiment_runner.cli import generalise as command
from experiment_runner.cli.generalise import generalise
from experiment_runner.study.generalisation.physics import outcomes, physics_table
from experiment_runner.study.generalisation.players import ACTIONS, Noise, digit_of
from experiment_runner.study.generalisation.verification import certify, differences, solvable
from glue import Action
from glue.errors import ConfigError


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
    for name, value in (("episode_return", 1000.0), ("goal", None), ("actions", "0")):
        forged = copy.deepcopy(result)
        forged["trials"][1]["few"][2][name] = value
        assert len(wrong(forged)) == 1
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
    score.update(level=0, actions="x")
    assert wrong(document)


@pytest.mark.usefixtures("few")
def test_certificates_reach_the_goal_and_are_kept(tmp_path: Path) -> None:
    out = tmp_path / "certificates.json"
    for levels in ("few:2", "few"):
        done = CliRunner().invoke(generalise, ["certify", levels, "--out", str(out)], catch_exceptions=False)
        assert done.exit_code == 0, done.output
    found = json.loads(out.read_text())
    assert [score["level"] for score in found["trials"][0]["few"]] == [0, 1, 2]
    assert solvable(found) == {0, 1, 2}
    assert not wrong(found)
    again = certify("few", found, lambda document: None)
    assert again["trials"] == found["trials"]
    run = ["--agent", "run-right", "--set", "few", "--seed", "1", "--out", str(tmp_path / "run")]
    shown = CliRunner().invoke(generalise, [*run, "--certificates", str(out)], catch_exceptions=False)
    assert "goal, if solvable" in shown.stdout


@pytest.mark.usefixtures("few")
def test_compressed_certificates_are_read_and_a_bomb_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    out = tmp_path / "certificates.json.gz"
    done = CliRunner().invoke(generalise, ["certify", "few:1", "--out", str(out)], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    first = out.read_bytes()
    assert CliRunner().invoke(generalise, ["verify", str(out)]).exit_code == 0
    assert CliRunner().invoke(generalise, ["certify", "few:1", "--out", str(out)]).exit_code == 0
    assert out.read_bytes() == first
    monkeypatch.setattr(command, "_MOST_BYTES", 2**20)
    out.write_bytes(gzip.compress(bytes(2**20 + 1)))
    refused = CliRunner().invoke(generalise, ["verify", str(out)], standalone_mode=False)
    assert isinstance(refused.exception, ConfigError)
    assert "longer than" in str(refused.exception)


def test_noise_replaces_the_given_share_of_actions_and_is_repeatable() -> None:
    action = Action(ints=[1, 0, 1])
    first, again, other = (Noise(0.2, seed, 7, 0) for seed in (1, 1, 2))
    made = [digit_of(first(action)) for _ in range(5000)]
    assert made == [digit_of(again(action)) for _ in range(5000)]
    assert made != [digit_of(other(action)) for _ in range(5000)]
    assert set(made) == ACTIONS.keys()
    assert 0.15 < sum(digit != digit_of(action) for digit in made) / len(made) < 0.22
    assert all(Noise(0, 1, 7, 0)(action) is action for _ in range(10))


def test_constants_are_identified_in_the_study() -> None:
    groups = ("instance-7", "random")
    played = [list(outcomes(group, 2)) for group in groups]
    for found in played:
        assert all(one.identified <= 10 for one in found)
        assert all(one.predicted > 0.9 for one in found)
    assert "| instance-7 | 2 | 1.000 |" in physics_table(groups, played)
    with pytest.raises(ConfigError):
        next(outcomes("instance-10", 1))
