"""The page in a real browser: it shows what the store holds, and nothing else happens."""

from __future__ import annotations

from pathlib import Path

from experiment_runner.analysis.settings import collect
from experiment_runner.plan.limits import TrialId
from experiment_runner.plan.plan import RoleSpec, TrialSpec
from experiment_runner.report.overview import setting_numbers
from experiment_runner.store.records import EpisodeResult
from experiment_runner.store.results import Results
from experiment_runner.store.store import Store
from experiment_runner.view.catalog import read_notes
from tests.experiment_runner.view.browser.chromium import Browser, needed
from tests.experiment_runner.view.pages import Page
from tests.experiment_runner.view.test_curves import NAME, store_run

needed()


def fill(folder: Path) -> None:
    store_run(folder / "named")


def test_a_run_shows_the_numbers_of_the_store(browser: Browser, page: Page, folder: Path) -> None:
    browser.go(f"run/{page.run_id('named')}")
    (row,) = browser.has_table("Results, by setting")
    with Results.open(folder / "named") as results:
        (setting,) = setting_numbers(collect([results]))
        seeds = [f"{seed[:3]}…{seed[-3:]}" for seed in (str(trial.spec.seed) for trial in results.trials())]
    assert row[0] == NAME
    shown = [row[1] for row in browser.has_table("Trials")]
    assert shown == [f"{each[:3]}…{each[-3:]}" for each in seeds]
    interval = f"{setting['low']:,.2f} to {setting['high']:,.2f} (!)"  # the mark of few trials
    assert row[3:5] == [f"{setting['mean']:,.2f}", interval]


def rows(browser: Browser) -> list[str]:
    """Return the group headings and the names of runs, in the order of the list."""
    found: list[str] = browser.run(
        "const found = document.querySelectorAll('.runs tbody tr:not([hidden]) th');"
        "return [...found].map((one) => one.textContent)"
    )
    return [name.removeprefix(f"{name.split('/')[0]}/") for name in found]


def test_runs_are_sorted_by_return_and_grouped_by_an_option(browser: Browser, folder: Path) -> None:
    for name, step_size, total in (("a", 0.5, -3.0), ("b", 0.05, 2.0), ("c", 0.5, 1.0)):
        role = RoleSpec("sarsa", {"step_size": step_size})
        spec = TrialSpec(TrialId("sarsa/mines/0"), role, RoleSpec("mines"), 10, 0, 2**62)
        with Store.create(folder / name, [spec], {}) as store:
            for episode in range(1, 5):
                store.record(spec.id, EpisodeResult(episode, total, 3, True, 0.1))
    browser.go("runs?search=sarsa")
    browser.wait(lambda: set(rows(browser)) == {"a", "b", "c"}, "three runs")
    assert str(2**62) not in browser.text()
    assert browser.find("[data-run] [data-label=Return]").text in ("-3.00", "1.00", "2.00")
    browser.button("Return").click()
    assert rows(browser) == ["b", "c", "a"]
    browser.button("Return").click()
    assert rows(browser) == ["a", "c", "b"]
    browser.run(
        "const it = document.querySelector('#group'); it.value = 'option step_size';"
        "it.dispatchEvent(new Event('change'))"
    )
    assert rows(browser) == ["step_size: 0.05", "b", "step_size: 0.5", "a", "c"]


def test_a_run_takes_notes_and_tags(browser: Browser, folder: Path) -> None:
    browser.go("runs?search=named")
    browser.find("[aria-label^='Edit the notes']")
    browser.run("document.querySelector('tr:not([hidden]) [aria-label^=\"Edit the notes\"]').click()")
    browser.find("[aria-label=Tags]").send_keys("good, <b>paper")
    browser.find("[aria-label=Note]").send_keys("as in the paper")
    browser.button("Save").click()
    browser.wait(lambda: (folder / "named/notes.json").exists(), "the file")
    assert read_notes(folder / "named") == {"note": "as in the paper", "tags": ["good", "<b>paper"]}
    browser.go("runs?search=paper")
    browser.shows("as in the paper")
    browser.wait(lambda: rows(browser) == ["named"], "the run")
    assert [one.text for one in browser.driver.find_elements("css selector", "tr:not([hidden]) .tag")] == [
        "good",
        "<b>paper",
    ]
