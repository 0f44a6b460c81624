"""The page while a real experiment runs at full speed, is killed, and resumes; a sleeping or slow page."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.experiment_runner.view.browser.chromium import Browser, browsing, needed
from tests.experiment_runner.view.pages import Page, glue_view
from tests.system.runs import start

needed()

PLAYERS = ("--env", "skeleton", "--agent", "skeleton", "--episodes", "300000", "--in-process")


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    (tmp_path / "runs").mkdir()
    with glue_view("runs", cwd=tmp_path) as page:
        yield page


@pytest.fixture
def browser(page: Page) -> Iterator[Browser]:
    with browsing(page) as browser:
        yield browser


def test_a_run_is_killed_and_goes_on_while_the_page_stays_open(
    browser: Browser, page: Page, tmp_path: Path
) -> None:
    browser.shows("There is no run here yet")
    browser.run("window.same = true")
    with start(*PLAYERS, "--out", "runs/fast", cwd=tmp_path) as process:
        try:
            browser.shows("running")
            browser.find("td input").click()
            browser.find("a.button").click()
            browser.shows("running mean of 100 episodes")
            before = browser.tables()["Results, by setting"]
            browser.wait(lambda: browser.tables()["Results, by setting"] != before, "more episodes")
        finally:
            process.kill()
    browser.find("#navigation a").click()
    browser.shows("interrupted")
    with start("--resume", "runs/fast", cwd=tmp_path) as process:
        try:
            browser.shows("running")
        finally:
            process.kill()
    browser.shows("interrupted")
    assert browser.run("return window.same") is True  # it was never reloaded
