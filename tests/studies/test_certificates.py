"""Certificates of levels reach the goal, are added to their file, and can be verified."""

from __future__ import annotations

from pathlib import Path

import pytest
from click.testing import CliRunner

from env_server.mario.level_sets import LEVEL_SETS, LevelSet
from experiment_runner.cli.generalise import generalise
from experiment_runner.study.generalisation.benchmark import read_scores
from experiment_runner.study.generalisation.verification import differences, solvable
from studies import certificates as search
from studies.certificates import certificates


def test_a_level_without_a_way_is_told_apart_from_one_that_was_searched_too_little(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    wall, floor = ("-" * 7 + "#" + "-" * 12 + "\n") * 14, "X" * 20
    for name, text in (("flat", floor), ("wall", wall + floor)):
        (tmp_path / f"{name}.txt").write_text(text)

    def lines() -> list[str]:
        out = tmp_path / f"{search._SIMS}.json"
        done = CliRunner().invoke(certificates, [str(tmp_path), "--out", str(out)], catch_exceptions=False)
        return [line for line in done.stdout.splitlines() if ".txt: " in line]

    monkeypatch.setattr(search, "_SIMS", 60_000)
    [line] = lines()
    assert line.startswith("wall.txt: no way among all states that the search tells apart (")
    monkeypatch.setattr(search, "_SIMS", 1_000)
    [line] = lines()
    assert line.startswith("wall.txt: no way was found in 2,")
    (tmp_path / "flat.txt").unlink()
    monkeypatch.setattr(search, "_SIMS", 2_000)
    assert len(lines()) == 1, "of a table without a goal and a step"


@pytest.mark.parametrize("name", ["certificates.json", "certificates.json.gz"])
def test_certificates_reach_the_goal_and_are_kept(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(LEVEL_SETS, "few", LevelSet(range(3)))
    out = tmp_path / name
    for levels in ("few:2", "few", "few"):
        before = out.read_bytes() if out.exists() else b""
        done = CliRunner().invoke(certificates, [levels, "--out", str(out)], catch_exceptions=False)
        assert done.exit_code == 0, done.output
    assert out.read_bytes() == before, "nothing was missing"
    found = read_scores(out)
    assert [score["level"] for score in found["trials"][0]["few"]] == [0, 1, 2]
    assert solvable(found) == {0, 1, 2}
    assert not list(differences(found, lambda line: None))
    run = ["--agent", "run-right", "--set", "few", "--seed", "1", "--out", str(tmp_path / "run")]
    shown = CliRunner().invoke(generalise, [*run, "--certificates", str(out)], catch_exceptions=False)
    assert "goal, if solvable" in shown.stdout
