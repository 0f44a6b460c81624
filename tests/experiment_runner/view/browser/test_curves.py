"""Curves in a real browser: drawn, in tables and in files with the server's numbers."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from tests.experiment_runner.view.browser.chromium import Browser, needed
from tests.experiment_runner.view.pages import Page
from tests.experiment_runner.view.test_curves import NAME, RETURNS, store_metrics, store_run
from tests.system.runs import wait_until

needed()

OTHER = '=cmd|"quoted", and a comma'


def fill(folder: Path) -> None:
    store_run(folder / "one")
    store_run(folder / "other", OTHER, -RETURNS)
    store_metrics(folder / "metrics")


@pytest.fixture(scope="module")
def both(page: Page) -> str:
    """The query for both runs."""
    return f"run={page.run_id('one')}&run={page.run_id('other')}"


def score(value: float) -> str:
    return f"{value:,.2f}"


def numbers_of(curve: dict[str, Any]) -> Iterator[tuple[float, ...]]:
    """Yield the position, the mean and both ends of the band, for every point of a curve."""
    return zip(*(curve[key] for key in ("at", "mean", "low", "high")), strict=True)


def test_two_runs_are_compared_and_their_tables_hold_the_numbers(
    browser: Browser, page: Page, both: str
) -> None:
    curves = page.ask(f"/api/curves?{both}").json()["curves"]
    assert [curve["label"] for curve in curves] == [NAME, OTHER]
    browser.go(f"curves?{both}")
    for curve in curves:
        rows = browser.has_table(f"{curve['label']}: running mean")
        known = {
            f"{at:,.0f}": [score(mean), f"{score(low)} to {score(high)}"]
            for at, mean, low, high in numbers_of(curve)
        }
        assert len(rows) > 10
        assert all(known[at] == rest for at, *rest in rows)
        assert [rows[0][0], rows[-1][0]] == [f"{curve['at'][i]:,.0f}" for i in (0, -1)]
    assert [row[0] for row in browser.tables()["Results, by setting"]] == [f"● {NAME}", f"▲ {OTHER}"]


def test_dragging_zooms_and_the_part_stays_until_the_whole_is_wanted(browser: Browser, both: str) -> None:
    from selenium.webdriver import ActionChains

    browser.go(f"curves?{both}")
    before = browser.has_table(f"{NAME}: running mean")
    over = browser.find(".plot")  # not the drawing in it, which the page may replace at any time
    ActionChains(browser.driver).move_to_element_with_offset(over, -100, 0).click_and_hold().move_by_offset(
        150, 0
    ).release().perform()
    browser.shows("; a part.")
    caption = f"{NAME}: running mean"
    browser.wait(lambda: browser.tables()[caption] != before, "a part")
    after = browser.tables()[caption]
    assert float(after[0][0]) > float(before[0][0])
    assert float(after[-1][0]) < float(before[-1][0])
    browser.button("Whole run").click()
    browser.wait(lambda: browser.tables()[caption] == before, "the whole run")


@pytest.mark.parametrize("over", ["episodes", "steps"])
def test_csv_holds_exactly_what_the_server_has_computed(
    browser: Browser, page: Page, both: str, over: str, tmp_path: Path
) -> None:
    curves = page.ask(f"/api/curves?{both}&over={over}").json()["curves"]
    text = saved(browser, f"curves?{both}&over={over}", "CSV", tmp_path / "curves.csv").decode()
    head, *rows = csv.reader(text.splitlines())
    assert head == ["setting", over[:-1], "mean", "low", "high"]
    labels = (NAME, f"'{OTHER}")  # quoted, so that it is no formula
    expected = [
        (label, *numbers)
        for label, curve in zip(labels, curves, strict=True)
        for numbers in numbers_of(curve)
    ]
    assert [(label, *map(float, numbers)) for label, *numbers in rows] == expected


def saved(browser: Browser, view: str, button: str, file: Path) -> bytes:
    """Press a button of a view; return the file that it saves."""
    browser.save_into(file.parent)
    browser.go(view)
    browser.has_table("Results, by setting")  # it adds a scroll bar, which makes the plot narrower
    browser.button(button).click()
    wait_until(file.exists, file.name)
    return file.read_bytes()
