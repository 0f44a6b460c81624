"""The standings in a real browser, from the competition's first trial to its places."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.experiment_runner.view.browser.chromium import Browser, browsing, needed
from tests.experiment_runner.view.contests import MATCHES, TITLE, write_competition
from tests.experiment_runner.view.pages import in_terminal
from tests.forked import run

needed()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("competition")
    write_competition(folder)
    return folder


@pytest.fixture(scope="module")
def browser(folder: Path) -> Iterator[Browser]:
    """A browser that shows the page of `glue-compete run --view` in a terminal."""
    command = ("glue-compete", "run", "spring.toml", "--out", "held", "--workers", "2")
    with in_terminal(*command, cwd=folder) as (page, _):
        with browsing(page) as browser:
            yield browser
        assert page.stop() == 0


def number(value: float) -> str:
    return f"{value:,.2f}"


def expected(board: dict[str, Any]) -> dict[str, list[list[str]]]:
    """Return the tables that show a board given as JSON."""
    placed = [one for one in board["entrants"] if one["place"] is not None]
    return {
        "Places": [
            [
                str(one["place"]),
                one["name"],
                number(one["mean_rank"]),
                number(one["total"]),
                f"{number(one['low'])} to {number(one['high'])}",
                str(one["place_by_total"]),
                *(
                    f"{number(one['tasks'][task]['score'])} ({one['tasks'][task]['rank']:g})"
                    for task in board["tasks"]
                ),
            ]
            for one in placed
        ],
        "Forfeits": [
            [one["name"], lost["task"], str(lost["trial"]), lost["reason"]]
            for one in board["entrants"]
            for lost in one["forfeits"]
        ],
    }


def test_standings_come_while_the_competition_goes_on(browser: Browser, folder: Path) -> None:
    browser.shows(f"0 of {MATCHES} trials are over")
    browser.shows("Nobody has a place yet")
    (folder / "go").touch()
    browser.shows(f"{MATCHES} of {MATCHES} trials are over, 0 verified")
    verified = run("glue-compete", "verify", "held", cwd=folder)
    assert verified.returncode == 0, verified.stderr
    browser.shows(f"{MATCHES} verified")
    browser.go("")
    browser.shows(f"{MATCHES} / {MATCHES} trials")
    browser.shows("finished")  # although a task of steps has fewer episodes than were planned
    browser.find("tbody th a").click()
    browser.shows("secret")
    browser.find("a[href^='#/standings/']").click()


def test_standings_are_those_of_glue_compete_board(browser: Browser, folder: Path) -> None:
    board = json.loads(run("glue-compete", "board", "held", "--format", "json", cwd=folder).stdout)
    tables = expected(board)
    assert len(tables["Places"]) == 2
    assert len(tables["Forfeits"]) == 4
    assert all("<script>alert(2)</script>" in row[-1] for row in tables["Forfeits"])
    assert browser.has_table("Places")
    assert browser.tables() == tables
    assert browser.find("h1").text == TITLE


def test_nothing_went_wrong_and_no_other_host_was_asked(browser: Browser) -> None:
    assert browser.errors() == []
    assert browser.foreign() == []
