"""The game in a real browser: the canvas equals the drawing of glue-replay, pixel for pixel."""

from __future__ import annotations

import base64
import io
import json
from pathlib import Path

import numpy as np
import numpy.typing as npt
import pytest

from env_server.mario.environment import InfiniteMario
from env_server.render.artwork import PALETTE
from env_server.render.drawing import draw
from env_server.toys import MinesEnvironment
from glue.roles import Environment
from glue.trajectory import Run, TrajectoryReader, TrajectoryWriter
from glue.types import Action, Observation
from tests.experiment_runner.view.browser.chromium import Browser, needed
from tests.experiment_runner.view.game.test_episodes import SPEC
from tests.experiment_runner.view.game.test_live import playing, started
from tests.experiment_runner.view.pages import Page
from tests.experiment_runner.view.test_stream import make_run

needed()
selenium_keys = pytest.importorskip("selenium.webdriver").Keys

STEPS = 60
HOSTILE = "<script>alert(1)</script>"
RIGHT, DOWN = [1, 1, 1], [1]
MARKS = ((4.03, 3.5), (5.5, 6.25), (300.0, 2.0), (7.0, -4.0))  # the first two are in view
LEVELS = {0: 33, 1: 19, 2: 28}  # for each type, a seed with which Mario gets far and meets many monsters
Pixels = npt.NDArray[np.uint8]


def play(
    writer: TrajectoryWriter, environment: Environment, name: str, action: list[int], steps: int
) -> None:
    writer.run(Run(name, {}, environment.env_init()))
    writer.start(environment.env_start())
    for step in range(steps):
        # A new jump needs the button to be released first.
        pressed = Action(action if (step + 1) % 4 or len(action) == 1 else [1, 0, 1])
        reward, seen, terminal, *_ = environment.env_step(pressed)
        writer.step(pressed, reward, seen, terminal)
        if terminal:
            return
    writer.cutoff()


def fill(folder: Path) -> None:
    for name in ("mario", "planned", "toys"):
        make_run(folder / name).close()
    with TrajectoryWriter(folder / "mario/run.traj") as writer:
        for kind, seed in LEVELS.items():
            mario = InfiniteMario(level_seed=seed, level_type=kind, level_difficulty=3)
            play(writer, mario, "mario", RIGHT, STEPS)
    with TrajectoryWriter(folder / "planned/run.traj") as writer:
        mario = InfiniteMario(level_seed=33)
        writer.run(Run("mario", {}, mario.env_init()))
        writer.answer("marks", json.dumps(MARKS))
        writer.start(mario.env_start())
        writer.answer("marks", HOSTILE)
        writer.step(Action(RIGHT), *mario.env_step(Action(RIGHT))[:3])
        writer.cutoff()
    with TrajectoryWriter(folder / "toys/run.traj") as writer:
        play(writer, MinesEnvironment(), "mines", DOWN, 3)
        writer.run(Run("strange", {}, SPEC))
        for step in range(4):
            if step != 2:
                writer.answer(HOSTILE, f"{HOSTILE} {step}")
            if step == 1:
                writer.answer("epsilon", "0.5\n" * 99)
            if step == 0:
                writer.start(Observation([4, 5], [1 / 3], b"<i>"))
            else:
                writer.step(Action([1], [0.5]), 2.0, Observation([7, 5], [-1e300], b"\x00ab"), step == 3)


@pytest.fixture(scope="module")
def ids(page: Page) -> dict[str, str]:
    runs = page.stream("topic=runs").next()["runs"].values()
    return {run["name"].rpartition("/")[2]: run["id"] for run in runs}


def facts(browser: Browser) -> dict[str, str]:
    found: dict[str, str] = browser.run(
        "return Object.fromEntries([...document.querySelectorAll('[data-fact]')]"
        ".map((one) => [one.dataset.fact, one.textContent]))"
    )
    return found


def answers(browser: Browser) -> dict[str, str]:
    """Return the agent's answers shown next to the game, by message."""
    found: dict[str, str] = browser.run(
        "return Object.fromEntries([...document.querySelectorAll('[data-answer]')]"
        ".map((one) => [one.previousElementSibling.textContent, one.textContent]))"
    )
    return found


def is_at(browser: Browser, step: int) -> None:
    browser.wait(lambda: facts(browser).get("step") == str(step), f"step {step}")


def seek(browser: Browser, step: int) -> None:
    browser.run(
        "const slider = document.querySelector('.timeline input'); slider.value = arguments[0];"
        "slider.dispatchEvent(new Event('input'))",
        step,
    )
    is_at(browser, step)


def pixels(browser: Browser) -> Pixels:
    from PIL import Image

    data = browser.run("return document.querySelector('.screen canvas').toDataURL('image/png')")
    image = Image.open(io.BytesIO(base64.b64decode(data.partition(",")[2])))
    return np.asarray(image.convert("RGB"))


@pytest.mark.parametrize("kind", LEVELS)
def test_every_kind_of_level_is_drawn_so_at_many_steps(
    browser: Browser, ids: dict[str, str], folder: Path, kind: int
) -> None:
    episode = list(TrajectoryReader(folder / "mario/run.traj"))[kind]
    colors = np.array(list(PALETTE.values()), np.uint8)
    browser.go(f"game/{ids['mario']}/{kind + 1}")
    is_at(browser, 0)
    total = 0.0
    for step, done in enumerate(episode.steps, 1):
        total += done.reward
        if step % 9 and step != len(episode.steps):
            continue
        seek(browser, step)
        assert done.observation is not None
        np.testing.assert_array_equal(pixels(browser), colors[draw(done.observation)], f"step {step}")
        shown = facts(browser)
        assert shown["action"] == ("right, jump, run" if done.action.ints[1] else "right, run")
        assert float(shown["reward"].replace(",", "")) == pytest.approx(done.reward, abs=1e-4)
        assert float(shown["return"].replace(",", "")) == pytest.approx(total, abs=1e-4)
    assert shown["state"] == {"terminal": "terminal", "cutoff": "cut off"}[episode.ending.value]


def test_the_plan_that_an_agent_answers_is_drawn(browser: Browser, ids: dict[str, str], folder: Path) -> None:
    [episode] = TrajectoryReader(folder / "planned/run.traj")
    colors = np.array(list(PALETTE.values()), np.uint8)
    browser.go(f"game/{ids['planned']}/1")
    is_at(browser, 0)
    start, then = episode.start, episode.steps[0].observation
    assert start is not None
    assert then is not None
    assert (draw(start, MARKS) != draw(start)).sum() > 13
    np.testing.assert_array_equal(pixels(browser), colors[draw(start, MARKS)])
    browser.press(selenium_keys.ARROW_RIGHT)  # to an answer that is not a plan
    is_at(browser, 1)
    assert answers(browser) == {"marks": HOSTILE}
    np.testing.assert_array_equal(pixels(browser), colors[draw(then)])


def test_it_is_played_by_keys(browser: Browser, ids: dict[str, str]) -> None:
    keys = selenium_keys
    browser.go(f"game/{ids['mario']}/1?step=5")
    is_at(browser, 5)
    for pressed, step in (
        (keys.ARROW_RIGHT, 6),
        (keys.ARROW_LEFT, 5),
        (keys.PAGE_DOWN, 15),
        (keys.END, STEPS),
        (keys.ARROW_RIGHT, STEPS),
        (keys.HOME, 0),
        (keys.ARROW_LEFT, 0),
    ):
        browser.press(pressed)
        is_at(browser, step)
    browser.run("document.querySelector('#speed').value = '120'")
    browser.press(" ")
    is_at(browser, STEPS)
    assert browser.find("button.primary").get_attribute("aria-label") == "Play"  # it stopped at the end
    browser.press(" ")  # from the start again
    browser.wait(lambda: facts(browser)["step"] != str(STEPS), "the start")
    browser.press(" ")
    assert browser.find("button.primary").get_attribute("aria-label") == "Play"


def test_any_other_environment_has_a_table_of_its_numbers(browser: Browser, ids: dict[str, str]) -> None:
    browser.go(f"game/{ids['toys']}/2")
    assert browser.has_table("Observation") == [
        ["int 0", "4", "0 to 9"],
        ["int 1", "5", "0 to 9"],
        ["double 0", str(1 / 3), "-1 to no limit"],
        ["chars 0 to 2", "<i>", ""],
    ]
    browser.press(selenium_keys.END)
    is_at(browser, 3)
    assert [row[1] for row in browser.has_table("Observation")] == ["7", "5", "-1e+300", "·ab"]
    assert facts(browser)["action"] == "1, 0.5"
    assert facts(browser)["state"] == "terminal"


def test_what_there_is_not_is_said(browser: Browser, ids: dict[str, str]) -> None:
    assert browser.errors() == []
    browser.go(f"game/{ids['mario']}/9")
    browser.shows("the recording has no episode 9")
    assert len(browser.errors()) == 1  # the response's status


def test_a_trial_in_progress_is_seen(browser: Browser, page: Page, folder: Path) -> None:
    with playing("--out", "running", "--ask", HOSTILE, cwd=folder):
        browser.go(f"game/{started(page, page.stream('topic=runs'))}")
        canvas = browser.find(".live .screen canvas:not([hidden])")
        browser.wait(lambda: facts(browser).get("action") in ("up", "down", "left", "right"), "a step")
        seen: set[str] = set()

        def many() -> bool:
            seen.add(canvas.get_attribute("aria-label"))
            return len(seen) > 5

        browser.wait(many, "six fields")
        assert all(" of the mines" in label for label in seen)
        browser.wait(lambda: HOSTILE in answers(browser), "an answer")
        browser.go(f"run/{page.run_id('running')}")
        ((trial, _, message, answer),) = browser.has_table("What the agents answered last")
        assert (trial, message, answer) == ("random/mines/0", HOSTILE, "agent random answers no messages")
        browser.go(f"game/{page.run_id('running')}")
        browser.find(".live .screen canvas:not([hidden])")
    browser.shows("The run is over")
