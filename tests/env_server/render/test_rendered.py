"""`glue-env NAME --render`: the game is drawn, and plays as without the option."""

from __future__ import annotations

import io
import itertools
import os
import re
import signal
import subprocess
import time
from contextlib import closing
from pathlib import Path

from env_server.mario.environment import InfiniteMario
from env_server.render.live import Rendered
from env_server.render.text import draw_mines, draw_text
from env_server.toys import MinesEnvironment, SkeletonEnvironment
from glue import Action, Observation, check_environment
from glue.cli.screen import TerminalScreen, renderer
from glue.roles import capabilities
from tests.forked import BIN
from tests.terminal import Terminal, drawings, run_in_terminal, watched_terminal


class Notes(TerminalScreen):
    """Records what it should draw."""

    def __init__(self) -> None:
        super().__init__(io.StringIO())
        self.shown: list[tuple[float, ...]] = []
        self.closed = 0

    def show(self, observation: Observation, *numbers: float) -> None:  # type: ignore[override]
        self.shown.append(numbers)

    def close(self) -> None:
        self.closed += 1


def rendered() -> Rendered:
    return Rendered(MinesEnvironment(random_start=True), TerminalScreen(io.StringIO()))


def test_renderer_is_that_of_the_environment_or_the_one_it_derives_from() -> None:
    class HarderMario(InfiniteMario):
        """A user's own environment."""

    assert renderer(InfiniteMario()) is renderer(HarderMario()) is draw_text
    assert renderer(MinesEnvironment()) is draw_mines


def test_rendered_environment_keeps_the_contract() -> None:
    check_environment(rendered, episodes=2, steps=50)


def test_rendered_environment_is_the_same_in_all_else() -> None:
    plain, drawn = MinesEnvironment(random_start=True), rendered()
    for environment in plain, drawn:
        environment.env_seed(5)
    assert drawn.env_init() == plain.env_init()
    assert drawn.env_start() == plain.env_start()
    for action in (1, 3, 3, 0, 2):
        assert drawn.env_step(Action([action])) == plain.env_step(Action([action]))
    assert drawn.env_message("map") == plain.env_message("map")
    assert drawn.env_save() == plain.env_save()


def test_rendered_environment_offers_what_the_environment_does() -> None:
    for environment in MinesEnvironment(), SkeletonEnvironment(), InfiniteMario():
        assert capabilities(Rendered(environment, Notes())) == capabilities(environment)


def test_every_observation_is_shown_and_each_episode_counted_afresh() -> None:
    screen = Notes()
    environment = Rendered(MinesEnvironment(), screen)
    environment.env_init()
    for _ in range(2):
        environment.env_start()
        environment.env_step(Action([1]))
        environment.env_step(Action([1]))
    assert screen.shown == [(0.0, 0, 0.0), (-1.0, 1, -1.0), (-1.0, 2, -2.0)] * 2
    environment.env_cleanup()
    assert screen.closed == 1


def test_environment_is_drawn_in_its_terminal(tmp_path: Path) -> None:
    hub = f"ipc://{tmp_path}/hub"
    options = ("--agent", "skeleton", "--episodes", "1", "--max-steps", "12", "--bind", hub)
    with closing(Terminal("glue-experiment", *options, cwd=tmp_path)) as experiment:
        status, text = run_in_terminal("glue-env", "mario", "--render", "--hub", hub, cwd=tmp_path)
        assert (experiment.end(), status) == (0, 0), (experiment.lines, text)
    first, last = drawings(text)[0], drawings(text)[-1]
    assert re.search(r"mm Mario.*  speed .*\nstep 0  reward 0  return 0\.00", first)
    assert re.search(r"mm Mario.*  speed .*\nstep 11  reward -?[\d.]+  return -?[\d.]+", last)
    assert "goodbye" in text[text.rindex("\x1b[?25h") :], "the cursor is back before the last line"


def test_second_run_is_drawn_like_the_first() -> None:
    with watched_terminal() as (descriptor, written), os.fdopen(os.dup(descriptor), "w") as stream:
        environment = Rendered(MinesEnvironment(), TerminalScreen(stream, clock=itertools.count().__next__))
        for _ in range(2):
            environment.env_init()
            environment.env_start()
            environment.env_step(Action([1]))
            environment.env_cleanup()
    text = b"".join(written).decode()
    runs = text.split("\x1b[?25h")
    assert [drawing.count("step 1") for drawing in runs] == [1, 1, 0]


def test_interrupt_gives_the_cursor_back(tmp_path: Path) -> None:
    hub = f"ipc://{tmp_path}/hub"
    options = ("--agent", "random", "--episodes", "100000", "--bind", hub)
    command: list[str | Path] = [BIN / "glue-env", "mines", "--render", "--hub", hub]
    with (
        closing(Terminal("glue-experiment", *options, cwd=tmp_path)),
        watched_terminal() as (descriptor, written),
        subprocess.Popen(command, cwd=tmp_path, stdout=descriptor, stderr=descriptor) as process,
    ):
        while b"step 3" not in b"".join(written):
            assert process.poll() is None, written
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        assert process.wait(60) == 130
    text = b"".join(written)
    assert text.rindex(b"\x1b[?25h") > text.rindex(b"\x1b[?25l")
