"""After a season: the testing tasks, the bundle that others verify, grades and the forms of the board."""

from __future__ import annotations

import json
from functools import partial
from pathlib import Path

import pytest

from experiment_runner.competition.season.board import ORGANISER
from experiment_runner.competition.season.forms import GRADES, as_text, boards_as_json
from experiment_runner.store.store import Store
from tests.experiment_runner.competition import contest
from tests.experiment_runner.competition.season.inside import FILE, Season
from tests.experiment_runner.competition.season.made import FILE as MADE
from tests.experiment_runner.competition.season.made import Made

TESTING = 'final = { env = "skeleton", episodes = 2 }\n'
WITH_TESTING = FILE + TESTING + contest.ENTRANT.format(name="walk", kind="walk")


@pytest.mark.stage("season")
def test_a_season_is_closed_tested_bundled_and_verified(tmp_path: Path) -> None:
    contest.write(tmp_path, WITH_TESTING)
    season = Season(tmp_path, WITH_TESTING)
    compete = partial(contest.compete, tmp_path, secret="nobody knows")
    run = ("run", "spring.toml", "--out", "run")
    with season.stack:
        season.enrol("alice")
        season.attempt("alice")
        season.act("exclude", "alice")
        season.turns()
        assert season.states("walk") == {1: "over"}
    assert "the season is not over: glue-compete serve" in compete(*run, status=1)
    assert "the season is not closed: glue-compete close" in compete("bundle", "run", "bundle", status=1)
    shown = json.loads(compete("board", "run", "--format", "json"))
    assert [(row["name"], row["place"]) for row in shown["entrants"]] == [("walk", 1), ("alice", None)]

    compete("close", "run", "--why", "it is over")
    assert "all 2 trials are over" in compete(*run)
    assert "6 of 6 trials are verified" in compete("verify", "run")
    assert ["1", "walk"] in [line.split()[:2] for line in compete("board", "run").splitlines()]
    assert "alice" in compete("board", "run", "--season")
    compete("bundle", "run", "bundle")
    assert {path.name for path in (tmp_path / "bundle").iterdir()} == {
        *("board.json", "competition.toml", "journal.jsonl", "lock", "records", "results.sqlite"),
        *("run.json", "seal.json"),
    }
    assert "6 of 6 trials are verified" in compete("verify", "bundle")
    board = tmp_path / "bundle" / "board.json"
    found = json.loads(board.read_text())
    assert found["season"]["entrants"][0]["score"] == shown["entrants"][0]["score"]
    grade = found["standings"]["entrants"][0]["total"]
    assert f"walk,{grade}" in compete("export", "run", "--grades", "moodle")
    found["season"]["entrants"][0]["score"] += 1
    board.write_text(json.dumps(found))
    assert "board.json is not the board" in compete("verify", "bundle", status=1)


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
