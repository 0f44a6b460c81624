"""The page of a season in a real browser, on a phone and on a projector, for all and for its organiser."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import timedelta
from urllib.parse import quote

import pytest
from starlette.staticfiles import StaticFiles

from experiment_runner.competition.season.control import Attempt
from experiment_runner.competition.trials import pseudonym
from tests.experiment_runner.competition.season.inside import SECRET, Season
from tests.experiment_runner.view.browser.chromium import Browser, browsing, needed
from tests.experiment_runner.view.pages import Page, in_thread, shown_by
from tests.experiment_runner.view.season.test_page import MOLE, OTTER, Shown

needed()

SIZES = {"phone": (360, 780), "projector": (1920, 1080)}

VOLE = pseudonym("carol", SECRET, ())
ADDRESS = quote(OTTER)

VIEWS = {
    "board": "What the organiser did",
    "board?projector=1": "Rules",
    f"entrant/{ADDRESS}": "Replay of attempt 1",
    f"replay/{ADDRESS}/1": "mines, trial 1",
    f"replay/{ADDRESS}/1/mines/1/2": "Link to this moment",
    "entrant/nobody": "there is no such entrant",
}
"""Each view of the public, and a text that it shows once it is loaded."""


@pytest.fixture(scope="module")
def held(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Season]:
    """Like that of the page's tests, with a second attempt of alice's and one who is excluded."""
    season = Shown(tmp_path_factory.mktemp("spring")).held
    with season.stack:
        season.enrol("carol")
        season.today += timedelta(minutes=1)
        season.attempt("alice")
        season.act("exclude", "carol")
        season.act("pause")
        season.ask(Attempt("alice"))
        yield season


@pytest.fixture(scope="module")
def page(held: Season) -> Iterator[Page]:
    command = ("glue-compete", "page", "run", "--page", "127.0.0.1:0", "--publish", "public")
    with shown_by(*command, cwd=held.folder) as page:
        yield page


@pytest.fixture(scope="module")
def browser(page: Page) -> Iterator[Browser]:
    """A browser without a token."""
    with browsing(page) as browser:
        browser.driver.delete_all_cookies()
        yield browser


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("view", VIEWS)
def test_every_view_fits_the_window_and_axe_finds_nothing(browser: Browser, view: str, size: str) -> None:
    browser.set_size(*SIZES[size])
    browser.go(view)
    browser.shows(VIEWS[view])
    assert browser.run("return document.documentElement.scrollWidth") <= SIZES[size][0]
    for is_dark in (False, True):
        browser.set_dark(is_dark)
        assert browser.faults() == [], f"dark: {is_dark}"


def test_the_board_shows_places_queue_and_what_the_organiser_did(browser: Browser) -> None:
    browser.set_size(1200, 900)
    browser.go("board")
    rows = browser.has_table("Places")
    assert [row[1].split(" no ")[0] for row in rows[:2]] == [OTTER, MOLE]
    assert [row[0] for row in rows] == ["1", "2", "-"]
    assert browser.find("ol").text == OTTER
    browser.shows(f"excluded: {VOLE}")
    assert "alice" not in browser.text()


def test_an_announcement_appears_by_itself(browser: Browser, held: Season) -> None:
    browser.go("board")
    browser.shows("Rules")
    held.act("announce", why="We <i>move</i> the server tonight.")
    browser.shows("We <i>move</i> the server tonight.")


def test_from_the_board_a_click_leads_to_an_entrant_its_attempt_and_its_picture(browser: Browser) -> None:
    browser.go("board")
    browser.find(f"a[href='#/entrant/{ADDRESS}']").click()
    rows = browser.has_table("Attempts")
    assert [row[:2] for row in rows[1:]] == [["2", rows[1][1]], ["1", rows[2][1]]]
    assert sum("counts" in row[1] for row in rows) == 1  # the best of them
    browser.find(f"a[href='#/replay/{ADDRESS}/1']").click()
    browser.find(f"a[href='#/replay/{ADDRESS}/1/mines/0/1']").click()
    canvas = browser.find("canvas[role=img]:not([hidden])")
    assert canvas.get_attribute("aria-label")
    browser.find("button[aria-label='Last step']").click()
    browser.wait(lambda: "step=" in browser.driver.current_url, "the step in the address")


def test_the_organiser_sees_names_hidden_tasks_and_reasons(page: Page, browser: Browser) -> None:
    browser.driver.get(page.url)
    browser.shows("you see what the organiser sees")
    rows = browser.has_table("Places")
    assert {row[1].split()[0] for row in rows} >= {"alice", "bob"}
    browser.go("entrant/bob")
    browser.shows("<b>no idea</b>")
    browser.driver.delete_all_cookies()
    browser.go("board")
    browser.shows(MOLE)


def test_the_published_page_is_the_same_without_replays(browser: Browser, held: Season) -> None:
    browser.go("board")
    places = browser.has_table("Places")
    assert [line for line in browser.errors() if "/entrants/nobody.json" not in line] == []
    with in_thread(lambda port: StaticFiles(directory=held.folder / "public", html=True), ws="none") as port:
        browser.driver.get(f"http://127.0.0.1:{port}/")
        assert browser.has_table("Places") == places
        browser.find(f"a[href='#/entrant/{ADDRESS}']").click()
        browser.has_table("Attempts")
        assert "Replay of" not in browser.text()
        browser.driver.get("about:blank")  # before its server ends
    assert "alice" not in "".join(path.read_text("utf-8") for path in held.folder.glob("public/**/*.json"))
