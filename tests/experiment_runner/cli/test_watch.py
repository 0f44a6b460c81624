"""`glue-watch`: its output, and its messages for mistakes."""

from __future__ import annotations

import io
import os
import re
from pathlib import Path

import pytest

from agents.mario.sample import SampleAgent
from agents.tabular import SarsaAgent
from env_server.mario.environment import InfiniteMario
from env_server.toys import MinesEnvironment, SkeletonEnvironment
from experiment_runner.cli.watch import play
from glue import ConfigError, Environment, Observation, local
from glue.cli.screen import Marks, TerminalScreen, read_marks, renderer
from tests.forked import run
from tests.terminal import drawings, run_in_terminal, watched_terminal


def test_watch_draws_the_game_in_a_terminal(tmp_path: Path) -> None:
    status, text = run_in_terminal(
        *("glue-watch", "--agent", "sample", "--max-steps", "12", "--speed", "1000", "--seed", "3"),
        cwd=tmp_path,
    )
    assert status == 0
    first, last = drawings(text)[0], drawings(text)[-1]
    for drawing in first, last:
        assert drawing.split("\n")[16].startswith("mm Mario")
        assert "sample in mario, episode 1" in drawing
    assert re.search(r"speed [+-]\d\.\d\d [+-]\d\.\d\d tiles/step\nstep 0  reward 0  return 0\.00", first)
    shown = re.search(r"step 11  reward -?[\d.]+  return (-?[\d.]+)\n", last)
    assert shown
    assert f"episode 1: return {shown[1]} in 12 steps" in last
    assert text.index("\x1b[?25l") < text.rindex("\x1b[?25h"), "the cursor comes back"


def test_play_waits_between_the_steps_that_a_person_sees() -> None:
    waits: list[float] = []
    with watched_terminal() as (writing, seen), local(SampleAgent(), InfiniteMario()) as glue:
        glue.rl_init(seed=3)
        with os.fdopen(writing, "w", closefd=False) as terminal:
            result = play(glue, TerminalScreen(terminal), "a title", 5, speed=4.0, sleep=waits.append)
        assert result == (glue.rl_return(), 5)
    assert b"a title" in b"".join(seen)
    assert waits == [0.25] * 4


def test_play_without_a_terminal_draws_nothing_and_does_not_wait() -> None:
    stream = io.StringIO()
    waits: list[float] = []
    with local(SarsaAgent(), MinesEnvironment()) as glue:
        glue.rl_init(seed=3)
        played = [play(glue, TerminalScreen(stream), "a title", 0, 0.1, waits.append) for _ in range(3)]
        glue.rl_init(seed=3)
        assert played == [(glue.rl_return(), glue.rl_num_steps()) for _ in range(3) if glue.rl_episode()]
    assert stream.getvalue() == ""
    assert set(waits) == {0.0}


def test_watch_plays_unseen_episodes_first_and_says_how_the_others_went(tmp_path: Path) -> None:
    shown = run(
        *("glue-watch", "--env", "mines", "--agent", "sarsa", "--after", "20", "--episodes", "2"),
        cwd=tmp_path,
    )
    assert shown.returncode == 0, shown.stderr
    assert re.findall(r"episode (\d+): return", shown.stderr) == ["21", "22"]
    assert shown.stdout == ""


@pytest.mark.parametrize(
    ("name", "agent", "drawn"),
    [("mines", 102, "@ . . . . G"), ("skeleton", 20, "-1 . . . "), ("mines", 0, "@ . . .")],
)
def test_the_toys_are_drawn_in_characters(name: str, agent: int, drawn: str) -> None:
    environment: Environment = {"mines": MinesEnvironment, "skeleton": SkeletonEnvironment}[name]()
    lines = renderer(environment)(Observation([agent]), False)
    assert any(drawn in line for line in lines), lines
    assert sum(line.count("@") for line in lines) == 1


class _Marking(SampleAgent):
    def agent_message(self, message: str) -> str:
        return "[[3.5, 4]]" if message == "marks" else ""


def test_play_asks_for_the_plan_before_each_step() -> None:
    shown: list[tuple[Observation, Marks]] = []
    with local(_Marking(), InfiniteMario()) as glue:
        glue.rl_init(seed=3)
        play(glue, TerminalScreen(io.StringIO()), "", 5, 1000, plan=True, shown=shown)
    assert [marks for _, marks in shown] == [((3.5, 4.0),)] * 5


def test_watch_writes_a_film(tmp_path: Path) -> None:
    shown = run("glue-watch", "--agent", "sample", "--max-steps", "3", "--gif", "a.gif", cwd=tmp_path)
    assert shown.returncode == 0
    assert (tmp_path / "a.gif").read_bytes().startswith(b"GIF89a")


@pytest.mark.parametrize(
    "answer",
    ["", "{}", '{"ab": 1}', "3", "[[1]]", "[[1, 2, 3]]", '[["a", 1]]', "[[1, NaN]]", "[[1, 2],[3, 1e999]]"],
)
def test_answer_that_is_no_plan_is_refused(answer: str) -> None:
    with pytest.raises(ConfigError):
        read_marks(answer)
