"""The page while a real experiment runs at full speed, is killed, and resumes; a sleeping or slow page."""

from __future__ import annotations

import base64
import os
import signal
import statistics
from collections.abc import Iterator
from pathlib import Path

import pytest

from experiment_runner.store.records import EpisodeResult
from glue.types import Observation, body_size
from tests.experiment_runner.view.browser.chromium import Browser, browsing, needed
from tests.experiment_runner.view.game.test_live import playing, started, until
from tests.experiment_runner.view.pages import Page, glue_view
from tests.experiment_runner.view.test_stream import make_run
from tests.system.runs import children, start

needed()

RUN = (
    "--env",
    "skeleton",
    "--agent",
    "skeleton",
    "--episodes",
    "300000",
    "--in-process",
    "--out",
    "runs/fast",
)
_GAPS = """
return new Promise((done) => {
  const gaps = [];
  let before = performance.now();
  function frame(now) {
    gaps.push(now - before);
    before = now;
    if (gaps.length < 40) requestAnimationFrame(frame);
    else done(Math.max(...gaps));
  }
  requestAnimationFrame(frame);
});
"""


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
    with start(*RUN, cwd=tmp_path) as process:
        try:
            browser.shows("running")
            browser.find("td input").click()
            browser.find("a.button").click()
            browser.shows("running mean of 100 episodes")
            # Drawing is smooth while numbers arrive; the median, as the machine may be busy.
            assert statistics.median(browser.run(_GAPS) for _ in range(5)) < 200
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
    assert browser.errors() == []


def shown_step(browser: Browser) -> str:
    return str(browser.run("return document.querySelector('[data-fact=step]')?.textContent ?? ''"))


def test_a_run_is_killed_and_goes_on_while_its_game_is_shown(
    browser: Browser, page: Page, tmp_path: Path
) -> None:
    players = ("--env", "skeleton", "--agent", "skeleton", "--episodes", "300000", "--checkpoint-every", "5")
    with start(*players, "--out", "runs/a", cwd=tmp_path) as process:
        try:
            browser.go(f"game/{started(page, page.stream('topic=runs'))}")
            browser.run("window.same = true")
            browser.wait(lambda: shown_step(browser), "a moment")
        finally:
            process.kill()
    browser.shows("The run is over")
    with start("--resume", "runs/a", cwd=tmp_path) as process:
        try:
            browser.shows("the newest of what is played")
            before = shown_step(browser)
            browser.wait(lambda: shown_step(browser) != before, "another moment")
        finally:
            process.kill()
    browser.shows("The run is over")
    assert browser.run("return window.same") is True
    assert browser.errors() == []


BROAD = """
from glue import Observation

SPEC = "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1 OBSERVATIONS INTS (0 POSINF)"


class Broad:
    steps = 0

    def env_init(self):
        return SPEC + " CHARCOUNT 100000 ACTIONS INTS (0 1) REWARDS (0 1)"

    def env_start(self):
        return self.seen()

    def env_step(self, action):
        return 1.0, self.seen(), self.steps % 100 == 0

    def seen(self):
        self.steps += 1
        return Observation([self.steps], [], b"x" * 100_000)

    def env_cleanup(self): ...

    def env_message(self, message):
        return ""
"""
"""An environment that counts its steps, with observations that fill the buffers between hub and page."""


_COUNT = """
window.drawn = 0;
const cell = document.querySelector(".numbers tbody td");
new MutationObserver(() => window.drawn++).observe(cell, { childList: true });
"""


def signal_all(pids: list[int], number: int) -> None:
    for pid in pids:
        os.kill(pid, number)


def test_a_browser_that_is_slow_misses_moments_and_nobody_waits_for_it(
    browser: Browser, page: Page, tmp_path: Path
) -> None:
    (tmp_path / "broad.py").write_text(BROAD)

    def newest() -> int:
        return int(browser.run("return document.querySelector('.numbers tbody td')?.textContent ?? '0'"))

    with playing("--out", "runs/a", env="broad.py:Broad", cwd=tmp_path):
        run = started(page, page.stream("topic=runs"))
        browser.go(f"game/{run}")
        browser.wait(newest, "a moment")
        browser.run(_COUNT)
        drawing = children(browser.driver.service.process.pid, "--type=renderer")
        signal_all(drawing, signal.SIGSTOP)  # from now on it reads nothing
        stream, seen = page.stream(f"topic=live:{run}"), list[int]()
        while len(seen) < 150:
            body = base64.b64decode(until(stream, f"live:{run}", "moment", {})["seen"])
            seen.append(Observation.from_body(body[body_size(body) :]).ints[0])
        assert sorted(set(seen)) == seen  # others continue, and are shown the newest step
        signal_all(drawing, signal.SIGCONT)
        browser.wait(lambda: newest() > seen[-1], "the newest moment")
        assert browser.run("return window.drawn") < len(seen)
        assert browser.errors() == []
        assert page.stop() == 130  # with a browser and a stream connected


_HIDE = """
const [hidden, later] = arguments;
const now = Date.now;
Date.now = () => now() + later;
Object.defineProperty(document, "hidden", { configurable: true, get: () => hidden });
document.dispatchEvent(new Event("visibilitychange"));
"""


def test_a_browser_that_comes_back_an_hour_later_goes_on_where_it_was(
    browser: Browser, page: Page, tmp_path: Path
) -> None:
    def returns() -> list[list[str]]:
        return browser.tables().get("Results, by setting", [])

    store = make_run(tmp_path / "runs" / "a")
    store.record("remote/remote/0", EpisodeResult(1, 3.0, 3, True, 0.1))
    browser.go(f"curves?run={page.run_id('a')}&window=7")
    browser.wait(lambda: [row[2] for row in returns()] == ["1"], "one episode")
    browser.run("window.same = true")
    browser.run(_HIDE, True, 0)
    page.run_id("a")
    address = browser.driver.current_url
    for episode in range(2, 5):
        store.record("remote/remote/0", EpisodeResult(episode, 3.0, 3, True, 0.1))
    page.run_id("a")  # others see it
    assert [row[2] for row in returns()] == ["1"]
    browser.run(_HIDE, False, 3_600_000)
    browser.wait(lambda: [row[2] for row in returns()] == ["4"], "four episodes")
    assert browser.driver.current_url == address
    assert browser.run("return [window.same, document.querySelector('#window').value]") == [True, "7"]
    store.record("remote/remote/0", EpisodeResult(5, 3.0, 3, True, 0.1))
    browser.wait(lambda: [row[2] for row in returns()] == ["5"], "five episodes")
    store.close()
    assert browser.errors() == []
