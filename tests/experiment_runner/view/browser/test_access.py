"""The accessibility of the page: axe-core finds nothing serious; a keyboard or a phone is enough."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.experiment_runner.competition.contest import compete, write
from tests.experiment_runner.view.browser.chromium import Browser, needed
from tests.experiment_runner.view.game.test_live import playing, started
from tests.experiment_runner.view.pages import Page
from tests.experiment_runner.view.test_curves import store_run
from tests.experiment_runner.view.test_stream import make_run
from tests.forked import run

needed()

TAB, ENTER = "\ue004", "\ue007"


def fill(folder: Path) -> None:
    store_run(folder / "done")
    make_run(folder / "interrupted").close()
    (folder / "damaged").mkdir()
    (folder / "damaged" / "results.sqlite").write_bytes(b"SQLite format 3\0" + b"\xff" * 5000)
    write(folder)
    compete(folder, "run", "spring.toml", "--out", "held")
    compete(folder, "verify", "held")
    recorded = ("--env", "mines", "--agent", "random", "--episodes", "1", "--out", "played")
    asked = ("--record", "played/run.traj", "--ask", "values")
    run("glue-experiment", *recorded, *asked, cwd=folder, status=0)


VIEWS = {
    "runs": "interrupted",
    "run/{done}": "Versions and machine",
    "curves": "Choose one or more runs",
    "curves?run={done}": "Results, by setting",
    "game/{played}": "run.traj",
    "game/{played}/1?step=1": "All episodes",
    "standings/{held}": "Places",
    "standings/{held}?projector=1": "Places",
    "run/nothing": "no such run",
}
"""Each view, and a text that it shows once it is loaded."""


def open_view(browser: Browser, page: Page, view: str) -> None:
    browser.go(view.format(**{name: page.run_id(name) for name in ("done", "held", "played")}))
    browser.shows(VIEWS[view])


def has_no_serious_faults(browser: Browser) -> None:
    for is_dark in (False, True):
        browser.set_dark(is_dark)
        assert browser.faults("serious", "critical") == [], f"dark: {is_dark}"


@pytest.mark.parametrize("view", VIEWS)
def test_a_phone_is_wide_enough_and_axe_finds_nothing_serious(
    browser: Browser, page: Page, view: str
) -> None:
    browser.set_size(360, 740)
    open_view(browser, page, view)
    widths = browser.run("return [document.documentElement.scrollWidth, innerWidth]")
    browser.set_size(1200, 800)
    assert widths == [360, 360]
    for summary in browser.driver.find_elements("css selector", "main details:not([open]) > summary"):
        summary.click()
    has_no_serious_faults(browser)


def test_axe_finds_nothing_serious_in_a_live_game(browser: Browser, page: Page, folder: Path) -> None:
    with playing("--out", "live", "--ask", "values", cwd=folder):
        browser.go(f"game/{started(page, page.stream('topic=runs'))}")
        browser.find("[data-answer]")
        has_no_serious_faults(browser)


def test_the_keyboard_leads_everywhere_in_the_order_of_the_page(browser: Browser, page: Page) -> None:
    open_view(browser, page, "runs")
    browser.press(TAB)
    assert focused(browser) == "Skip to the content"
    assert browser.find(".skip").rect["x"] >= 0  # visible once it has the focus
    browser.press(ENTER, TAB)
    assert browser.run("return document.activeElement.id") == "search"
    browser.go("runs")
    browser.shows("interrupted")
    reached = []
    for _ in range(26):
        browser.press(TAB)
        reached.append(focused(browser))
    for label in ("glue-view", "Runs", "Curves", "Switch between light and dark", "compare"):
        assert any(label in one for one in reached), reached
    places = browser.run(
        "const all = [...document.querySelectorAll('a, button, input, select, [tabindex]')];"
        "return all.map((one) => one.tabIndex)"
    )
    assert max(places) == 0  # nothing jumps the tab order


def test_the_keyboard_switches_the_theme_and_a_reader_hears_what_is_a_state(
    browser: Browser, page: Page
) -> None:
    browser.set_dark(False)
    open_view(browser, page, "runs")
    browser.run("document.getElementById('theme').focus()")
    browser.press(ENTER)
    assert browser.run("return getComputedStyle(document.documentElement).colorScheme") == "dark"
    browser.press(ENTER)
    assert browser.run("return getComputedStyle(document.documentElement).colorScheme") == "light"
    browser.run("localStorage.clear()")
    assert browser.find("#connection").get_attribute("role") == "status"


def focused(browser: Browser) -> str:
    """Return the name of the element with the focus."""
    name = "const it = document.activeElement; return it.getAttribute('aria-label') ?? it.innerText"
    return str(browser.run(name)).strip()
