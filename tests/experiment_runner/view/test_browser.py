"""The page in a real browser: what stands in it is what the store holds, and nothing else happens."""

from __future__ import annotations

from pathlib import Path

import pytest

from experiment_runner.analysis.settings import collect
from experiment_runner.report.overview import setting_numbers
from experiment_runner.store.records import EpisodeResult
from experiment_runner.store.results import Results
from tests.experiment_runner.view.chromium import Browser, needed
from tests.experiment_runner.view.pages import Page
from tests.experiment_runner.view.test_curves import NAME, store_run
from tests.experiment_runner.view.test_stream import make_run

needed()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    store_run(folder / "named")
    return folder


def test_the_list_follows_a_run(browser: Browser, folder: Path) -> None:
    browser.shows(NAME)
    assert "token" not in browser.driver.current_url
    with make_run(folder / "live") as store:
        browser.shows("live\n")
        store.record("remote/remote/0", EpisodeResult(1, 1.0, 3, True, 0.1))
        browser.shows("1 / 10")
        browser.shows("running")
    browser.shows("interrupted")


def test_a_run_shows_the_numbers_of_the_store(browser: Browser, page: Page, folder: Path) -> None:
    browser.go(f"run/{page.run_id('named')}")
    (row,) = browser.has_table("Results, by setting")
    with Results.open(folder / "named") as results:
        (setting,) = setting_numbers(collect([results]))
        seeds = [str(trial.spec.seed) for trial in results.trials()]
    assert row[0] == NAME
    assert [trial[1] for trial in browser.has_table("Trials")] == seeds
    assert row[3:5] == [f"{setting['mean']:,.2f}", f"{setting['low']:,.2f} to {setting['high']:,.2f}"]


def test_nothing_went_wrong_and_no_other_host_was_asked(browser: Browser) -> None:
    assert browser.errors() == []
    assert browser.foreign() == []
