"""Take screenshots of the page for the documentation, with real runs, which take some minutes.

`make screenshots` runs this program, which writes docs/images/view-*.png. It has the requirements of the
browser tests (`tests.experiment_runner.view.browser.chromium`).
"""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from subprocess import DEVNULL, Popen
from typing import Final

from tests.experiment_runner.view.browser.chromium import Browser, browsing
from tests.experiment_runner.view.pages import Page, glue_view
from tests.forked import BIN, run
from tests.house.imports import ROOT

FOLDER: Final = ROOT / "docs/images"

WIDE: Final = (1180, 760)
PHONE: Final = (390, 780)

_RECORDED: Final = ("glue-experiment", "--env", "mario", "--agent", "hierarchical", "--episodes", "2")
_ASKED: Final = ("--ask", "values", "--ask", "epsilon")
_SWEEP: Final = """\
episodes = 1500
max_steps = 500
trials = 5
seed = 1
[environments.mines]
random_start = true
[agents.sarsa]
step_size = [0.1, 0.3]
[agents.random]
"""
_TOURNAMENT: Final = f"""\
name = "Spring tournament"
trials = 2
seed_file = "secret.txt"
[tasks]
proving = {{ env = "mario", options.mdp = "proving-1", steps = 400 }}
unseen = {{ env = "mario", options.level_difficulty = 0, steps = 400 }}
[entrants]
runner.command = ["{BIN}/glue-agent", "run-right"]
sample.command = ["{BIN}/glue-agent", "sample"]
learner.command = ["{BIN}/glue-agent", "hierarchical"]
random.command = ["{BIN}/glue-agent", "random"]
absent.command = ["false"]
"""


def main(folder: Path) -> None:
    """Make the runs, and write the screenshots into a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as made:
        top = Path(made)
        _make(top)
        with _running(top), glue_view("runs", cwd=top) as page, browsing(page) as browser:
            for name, picture in _pictures(browser, page):
                (folder / f"view-{name}.png").write_bytes(picture)
                print(f"view-{name}.png: {len(picture):,} bytes", flush=True)


def _make(top: Path) -> None:
    (top / "sweep.toml").write_text(_SWEEP)
    (top / "spring.toml").write_text(_TOURNAMENT)
    secret = top / "secret.txt"
    secret.touch(0o600)
    secret.write_text("these are only pictures")
    experiment = ("glue-experiment", "--in-process", "--workers", "2", "--out")
    learning = ("--env", "mario", "--agent", "hierarchical", "--episodes", "100", "--trials", "2")
    for command in (
        (*experiment, "runs/step-sizes", "--plan", "sweep.toml"),
        (*experiment, "runs/mario", *learning),
        (*_RECORDED, *_ASKED, "--out", "runs/recorded", "--record", "runs/recorded/run.traj"),
        ("glue-compete", "run", "spring.toml", "--out", "runs/spring", "--workers", "2"),
        ("glue-compete", "verify", "runs/spring"),
    ):
        run(*command, cwd=top, timeout=600, status=0)


@contextmanager
def _running(top: Path) -> Iterator[None]:
    """Keep a run going in the background."""
    what = ("--env", "mario", "--agent", "hierarchical-facts", "--episodes", "5000", "--trials", "10")
    command = (BIN / "glue-experiment", *what, "--in-process", "--out", "runs/ten-trials")
    with Popen(command, cwd=top, stdout=DEVNULL, stderr=DEVNULL) as process:
        try:
            yield
        finally:
            process.terminate()


def _pictures(browser: Browser, page: Page) -> Iterator[tuple[str, bytes]]:
    sweep, spring = page.run_id("step-sizes"), page.run_id("spring")
    browser.set_size(*WIDE)
    browser.set_dark(False)
    # In one script: between two scripts the page may draw the table again.
    left = "return document.querySelector(`td[data-label='Time left']`)?.innerText"
    browser.wait(lambda: browser.run(left) not in (None, "", "…"), "the time left")
    yield "runs", browser.screenshot()
    browser.go(f"curves?run={sweep}&window=100")
    browser.has_table("Results, by setting")
    yield "curves", browser.screenshot()
    browser.go(f"standings/{spring}")
    browser.has_table("Places")
    browser.button("Projector").click()
    yield "projector", browser.screenshot()
    browser.go(f"game/{page.run_id('recorded')}/1?step=60")
    browser.find(".view-game canvas")
    browser.wait(lambda: "coin" in browser.text() or "step" in browser.text(), "the game")
    yield "game", browser.screenshot()
    browser.set_dark(True)
    browser.go(f"run/{sweep}")
    browser.has_table("Trials")
    yield "run-dark", browser.screenshot()
    browser.set_dark(False)
    browser.set_size(*PHONE, scale=2)
    browser.go("runs")
    browser.shows("spring")
    yield "phone", browser.screenshot()


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else FOLDER)
