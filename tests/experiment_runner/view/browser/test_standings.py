"""The standings in a real browser, from the competition's first trial to its places."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.experiment_runner.competition.contest import compete, write
from tests.experiment_runner.view.browser.chromium import Browser, browsing, needed
from tests.experiment_runner.view.pages import in_terminal

needed()


def fill(folder: Path) -> None:
    write(folder, go=False)


@pytest.fixture(scope="module")
def browser(folder: Path) -> Iterator[Browser]:
    """A browser that shows the page of `glue-compete run --view` in a terminal."""
    command = ("glue-compete", "run", "spring.toml", "--out", "held", "--workers", "2")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SECRET", "only a test")
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
    browser.shows("0 of 6 trials are over")
    browser.shows("Nobody has a place yet")
    (folder / "go").touch()
    browser.shows("6 of 6 trials are over, 0 verified")
    compete(folder, "verify", "held")
    browser.shows("6 verified")
    browser.go("")
    browser.shows("6 / 6 trials")
    browser.shows("finished")  # although a task of steps has fewer episodes than were planned
    browser.find("tbody th a").click()
    browser.shows("secret")
    browser.find("a[href^='#/standings/']").click()


def test_standings_are_those_of_glue_compete_board(browser: Browser, folder: Path) -> None:
    board = json.loads(compete(folder, "board", "held", "--format", "json"))
    tables = expected(board)
    assert len(tables["Places"]) == 3
    assert len(tables["Forfeits"]) == 4
    assert any("<script>alert(1)</script>" in row[-1] for row in tables["Forfeits"])
    assert browser.has_table("Places")
    assert browser.tables() == tables
    assert browser.find("h1").text == "<b>spring</b>"
