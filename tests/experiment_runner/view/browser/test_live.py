"""The page while a real experiment runs at full speed, is killed, and resumes; a sleeping or slow page."""

from __future__ import annotations

import base64
import os
import signal
import statistics
from collections.abc import Iterator
from pathlib import Path

import pytest

from glue.types import Observation, body_size
from tests.experiment_runner.view.browser.chromium import Browser, browsing, needed
from tests.experiment_runner.view.game.test_live import playing, started, until
from tests.experiment_runner.view.pages import Page, glue_view
from tests.system.runs import children, start

needed()

PLAYERS = ("--env", "skeleton", "--agent", "skeleton", "--episodes", "300000", "--in-process")
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
    with start(*PLAYERS, "--out", "runs/fast", cwd=tmp_path) as process:
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
