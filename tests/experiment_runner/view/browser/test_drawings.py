"""A third party's environment on the page: a package with an environment and a drawing as entry points."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.experiment_runner.view.browser.chromium import Browser, browsing, needed
from tests.experiment_runner.view.pages import glue_view
from tests.terminal import run_anew

needed()

_PACKAGE = """
from pathlib import Path
from glue import Observation

class Lamp:
    def env_init(self):
        return ("VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1 "
                "OBSERVATIONS INTS (0 255) ACTIONS INTS (0 1) REWARDS (0 1) EXTRA lamp")
    def env_start(self):
        self.steps = 0
        return Observation(ints=[0])
    def env_step(self, action):
        self.steps += 1
        return 1.0, Observation(ints=[40 * self.steps]), self.steps == 5

def fail():
    raise ValueError("no such file")

DRAWING = {"drawing.js": Path(__file__).with_name("lamp.js").read_bytes, "failing": fail}
"""
_SCRIPT = """
export const open = ({ extra }, file) => extra !== "lamp" ? null : {
  width: 8, height: 4,
  shows: ({ ints }) => ints.length === 1,
  draw(context, { ints: [light] }) {
    context.fillStyle = `rgb(${light}, 0, 0)`;
    context.fillRect(0, 0, 8, 4);
  },
  describe: ({ ints: [light] }) => `a lamp at ${light}`,
  words: ({ ints: [press] }) => press ? "press" : "wait",
  names: { int: () => "light" },
};
"""
_ENTRY_POINTS = """
[glue.environments]
lamp = lamp:Lamp
[glue.drawings]
lamp = lamp:DRAWING
broken = lamp:NOTHING
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A run of the package's environment; the package is installed for all programs that this module runs."""
    package = tmp_path_factory.mktemp("package")
    (package / "lamp.py").write_text(_PACKAGE)
    (package / "lamp.js").write_text(_SCRIPT)
    installed = package / "lamp-1.0.dist-info"
    installed.mkdir()
    (installed / "METADATA").write_text("Metadata-Version: 2.1\nName: lamp\nVersion: 1.0\n")
    (installed / "entry_points.txt").write_text(_ENTRY_POINTS)
    folder = tmp_path_factory.mktemp("runs")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", f"{package}{os.pathsep}{os.environ.get('PYTHONPATH', '')}")
        for name in ("lamp", "mines"):
            command = f"glue-experiment --env {name} --agent random --episodes 1 --max-steps 9 --in-process"
            made = ("--out", name, "--record", f"{name}/run.traj")
            played = run_anew(*command.split(), *made, cwd=folder)
            assert played.returncode == 0, played.stderr
        yield folder


def test_it_is_watched_as_our_own_are(folder: Path) -> None:
    with glue_view(folder) as page, browsing(page) as browser:
        _looks_like_a_lamp(browser, page.run_id("lamp"))
        browser.go(f"game/{page.run_id('mines')}/1")
        canvas = browser.find(".screen canvas:not([hidden])")
        assert canvas.get_attribute("aria-label") == "row 1, column 1 of the mines"
        listed = page.ask("/api/drawings").json()
        assert [one["name"] for one in listed] == ["broken", "lamp", "mario", "toys"]
        assert "AttributeError" in listed[0]["problem"]
        failed = page.ask("/drawings/lamp/failing")
        assert (failed.status, failed.json()["error"]) == (
            422,
            "the drawing lamp failed: ValueError: no such file",
        )


def _looks_like_a_lamp(browser: Browser, run_id: str) -> None:
    browser.go(f"game/{run_id}/1?step=3")
    canvas = browser.find(".screen canvas:not([hidden])")
    browser.wait(lambda: canvas.get_attribute("aria-label") == "a lamp at 120", "the lamp")
    seen = "return [...arguments[0].getContext('2d').getImageData(3, 2, 1, 1).data]"
    assert browser.run(seen, canvas) == [120, 0, 0, 255]
    assert browser.find("[data-fact=action]").text in ("press", "wait")
    browser.run("document.querySelector('.numbers').open = true")
    browser.wait(lambda: browser.has_table("Observation") == [["light", "120", "0 to 255"]], "the numbers")
