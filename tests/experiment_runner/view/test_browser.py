"""The page in a real browser: what stands in it is what the store holds, and nothing else happens.

Needs Debian's chromium and chromium-driver, and selenium; the stage "the page" of .ci/run installs them.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from experiment_runner.analysis.settings import collect
from experiment_runner.report.overview import setting_numbers
from experiment_runner.store.records import EpisodeResult
from experiment_runner.store.results import Results
from tests.experiment_runner.view.pages import Page, glue_view
from tests.experiment_runner.view.test_curves import NAME, store_run
from tests.experiment_runner.view.test_stream import make_run

if not (shutil.which("chromium") and shutil.which("chromedriver")):
    pytest.skip("needs chromium and chromium-driver", allow_module_level=True)
webdriver = pytest.importorskip("selenium.webdriver", reason="needs selenium")

SECONDS = 60.0


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("runs")
    store_run(folder / "named")
    return folder


@pytest.fixture(scope="module")
def page(folder: Path) -> Iterator[Page]:
    with glue_view(folder) as page:
        yield page


@pytest.fixture(scope="module")
def driver(page: Page) -> Iterator[Any]:
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium")
    for argument in ("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage"):
        options.add_argument(argument)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    driver = webdriver.Chrome(options, webdriver.ChromeService(shutil.which("chromedriver")))
    try:
        driver.get(page.url)
        yield driver
    finally:
        driver.quit()


def found(driver: Any, selector: str) -> Any:
    """Return an element when it is there."""
    from selenium.webdriver.support.ui import WebDriverWait

    return WebDriverWait(driver, SECONDS).until(lambda _: driver.find_elements("css selector", selector))[0]


def text_comes(driver: Any, selector: str, text: str) -> None:
    from selenium.webdriver.support.ui import WebDriverWait

    WebDriverWait(driver, SECONDS).until(
        lambda _: any(text in one.text for one in driver.find_elements("css selector", selector))
    )


def test_the_list_follows_a_run(driver: Any, folder: Path) -> None:
    text_comes(driver, "tbody tr", NAME)
    assert "token" not in driver.current_url
    with make_run(folder / "live") as store:
        text_comes(driver, "tbody tr", "live")
        store.record("remote/remote/0", EpisodeResult(1, 1.0, 3, True, 0.1))
        text_comes(driver, "tbody tr", "1 / 10")
        text_comes(driver, "tbody tr", "running")
    text_comes(driver, "tbody tr", "interrupted")


def test_a_run_shows_the_numbers_of_the_store(driver: Any, page: Page, folder: Path) -> None:
    for run in page.stream("topic=runs").next()["runs"].values():
        if run["name"].endswith("named"):
            driver.get(f"http://127.0.0.1:{page.port}/#/run/{run['id']}")
    text_comes(driver, "caption", "Results")
    with Results.open(folder / "named") as results:
        (setting,) = setting_numbers(collect([results]))
    cells = [cell.text for cell in driver.find_elements("css selector", "table:first-of-type tbody tr")[0:1]]
    assert NAME in cells[0]
    assert f"{setting['mean']:,.2f}" in cells[0]
    assert f"{setting['low']:,.2f} to {setting['high']:,.2f}" in cells[0]


def test_curves_are_drawn_and_their_table_holds_the_numbers(driver: Any, page: Page) -> None:
    runs = page.stream("topic=runs").next()["runs"].values()
    run_id = next(run["id"] for run in runs if run["name"].endswith("named"))
    (curve,) = page.ask(f"/api/curves?run={run_id}").json()["curves"]
    driver.get(f"http://127.0.0.1:{page.port}/#/curves?run={run_id}")
    found(driver, ".plot canvas")
    text_comes(driver, "caption", "running mean")
    rows = [row.text for row in driver.find_elements("css selector", "tbody tr")]
    assert any(f"{curve['mean'][0]:,.2f}" in row for row in rows)
    assert any(f"{curve['mean'][-1]:,.2f}" in row for row in rows)


def test_nothing_went_wrong_and_no_other_host_was_asked(driver: Any, page: Page) -> None:
    assert [line for line in driver.get_log("browser") if line["level"] == "SEVERE"] == []
    messages = [json.loads(line["message"])["message"] for line in driver.get_log("performance")]
    asked = [
        one["params"]["request"]["url"] for one in messages if one["method"] == "Network.requestWillBeSent"
    ]
    assert len(asked) > 10
    ours = (f"http://127.0.0.1:{page.port}/", "data:", "blob:")
    assert [url for url in asked if not url.startswith(ours)] == []
