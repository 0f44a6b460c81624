"""After a season: the testing tasks, the bundle that others verify, grades and the forms of the board."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest

from experiment_runner.competition.season.board import ORGANISER
from experiment_runner.competition.season.forms import GRADES, as_text, boards_as_json
from experiment_runner.store.store import Store
from tests.experiment_runner.competition import contest
from tests.experiment_runner.competition.season.inside import FILE, Season
from tests.experiment_runner.competition.season.made import FILE as MADE
from tests.experiment_runner.competition.season.made import Made

WITH_TESTING = (
    FILE
    + f"""
[tasks.final]
env = "skeleton"
episodes = 2
[entrants.walk]
command = ["{sys.executable}", "agent.py", "walk"]
"""
)


def compete(folder: Path, *arguments: str) -> str:
    """Run `glue-compete`; return its exit status and all that it prints."""
    done = contest.compete(folder, *arguments, secret="nobody knows")
    return f"{done.returncode}\n{done.stdout}{done.stderr}"


@pytest.mark.stage("season")
def test_a_season_is_closed_tested_bundled_and_verified(tmp_path: Path) -> None:
    contest.write(tmp_path, WITH_TESTING)
    season = Season(tmp_path, WITH_TESTING)
    run = ("run", "spring.toml", "--out", "run")
    with season.stack:
        season.enrol("alice")
        season.attempt("alice")
        season.act("exclude", "alice")
        season.turns()
        assert season.states("walk") == {1: "over"}
    assert "the season is not over: glue-compete serve" in compete(tmp_path, *run)
    assert "the season is not closed: glue-compete close" in compete(tmp_path, "bundle", "run", "bundle")
    shown = json.loads(compete(tmp_path, "board", "run", "--format", "json").partition("\n")[2])
    assert [(row["name"], row["place"]) for row in shown["entrants"]] == [("walk", 1), ("alice", None)]

    assert compete(tmp_path, "close", "run", "--why", "it is over")[0] == "0"
    assert "all 2 trials are over" in compete(tmp_path, *run)
    verified = compete(tmp_path, "verify", "run")
    assert verified.startswith("0\n6 of 6 trials are verified"), verified
    assert ["1", "walk"] in [line.split()[:2] for line in compete(tmp_path, "board", "run").splitlines()]
    assert "alice" in compete(tmp_path, "board", "run", "--season")
    assert compete(tmp_path, "bundle", "run", "bundle")[0] == "0"
    assert {path.name for path in (tmp_path / "bundle").iterdir()} == {
        *("board.json", "competition.toml", "journal.jsonl", "lock", "records", "results.sqlite"),
        *("run.json", "seal.json"),
    }
    assert compete(tmp_path, "verify", "bundle").startswith("0\n6 of 6 trials are verified")
    board = tmp_path / "bundle" / "board.json"
    found = json.loads(board.read_text())
    assert found["season"]["entrants"][0]["score"] == shown["entrants"][0]["score"]
    grade = found["standings"]["entrants"][0]["total"]
    assert f"walk,{grade}" in compete(tmp_path, "export", "run", "--grades", "moodle")
    found["season"]["entrants"][0]["score"] += 1
    board.write_text(json.dumps(found))
    assert "board.json is not the board" in compete(tmp_path, "verify", "bundle")


def test_a_journal_without_acts_has_no_board(tmp_path: Path) -> None:
    """As in a bundle whose journal somebody has emptied."""
    made = Made(text="\n".join(line for line in MADE.splitlines() if not line.startswith("final")))
    with Store.create(tmp_path / "run", [], {}) as store:
        assert boards_as_json(store, made.course) == "{}\n"


GRADES_OF = (("ann", 2.5), ("bob", float("nan")), ("cy", 2.5), ("dan", 1.0))


@pytest.mark.parametrize(
    ("form", "header", "row"),
    [
        ("canvas", "Student,ID,SIS User ID,SIS Login ID,Section,spring", "ann,,,ann,,2.5"),
        ("moodle", "username,spring", "ann,2.5"),
        ("csv", "place,entrant,spring", "1,ann,2.5"),
    ],
)
def test_grades_are_files_that_other_systems_take(form: str, header: str, row: str) -> None:
    lines = GRADES[form]("spring", GRADES_OF).splitlines()
    assert lines[:2] == [header, row]
    assert len(lines) == 5
    assert [line[-1] for line in lines if "bob" in line] == [","]


def test_a_season_is_shown_in_the_terminal() -> None:
    made = Made(["ann", "bob"])
    made.attempt("ann", 1.0, 2.0)
    made.attempt("ann", 1.0, forfeit="no answer for 5 s")
    made.act("announce", reason="a new level")
    shown = as_text(made.board(ORGANISER))
    for text in (
        "spring: open",
        "1.00 .. 2.00",
        "1 verified, 1 forfeited",
        "no place: bob",
        "5 s",
        "a new level",
    ):
        assert text in shown
