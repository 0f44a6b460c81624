from __future__ import annotations

import io
import json
import math
import re
from dataclasses import replace

import pytest

from experiment_runner.plan.plan import Plan, RoleSweep, TrialSpec
from experiment_runner.report.progress import JsonLines, Progress
from experiment_runner.store.records import EpisodeResult, TrialRecord
from tests.clock import Clock

PLAN = Plan(episodes=50, trials=3, environments=(RoleSweep("mines"),), agents=(RoleSweep("sarsa"),))
FIRST, SECOND, THIRD = PLAN.expand()


class Terminal(io.StringIO):
    """Interprets the output of `Progress` as a terminal does."""

    def isatty(self) -> bool:
        return True

    def screen(self) -> list[str]:
        lines, row = [""], 0
        for part in re.split(r"(\n|\r|\x1b\[\d*[A-Z])", self.getvalue()):
            if part == "\n":
                row += 1
                if row == len(lines):
                    lines.append("")
            elif part.startswith("\x1b["):
                count, what = int(part[2:-1] or 0), part[-1]
                if what == "A":
                    row -= count
                    assert row >= 0
                elif what == "J":
                    lines[row:] = [""]
                else:
                    assert what == "K"
            elif part and part != "\r":
                lines[row] = part  # lines are written whole, and the rest of each is cleared
        return lines


def result(episode: int, episode_return: float = 2.0, steps: int = 100) -> EpisodeResult:
    return EpisodeResult(episode, episode_return, steps, True, 0.5)


def bar(full: int, percent: int) -> str:
    return f"{'#' * full}{'.' * (55 - full)} {percent:3d}%"


def records(*specs: TrialSpec, done: int = 0) -> list[TrialRecord]:
    return [TrialRecord(spec, done, 0, None) for spec in specs]


@pytest.fixture
def clock() -> Clock:
    return Clock(1000.0)


@pytest.fixture
def terminal(monkeypatch: pytest.MonkeyPatch) -> Terminal:
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setenv("LINES", "8")
    return Terminal()


def begun(
    stream: io.StringIO, clock: Clock, *specs: TrialSpec, done: int = 0, color: bool = False
) -> Progress:
    progress = Progress(stream, clock, color=color)
    progress.start(records(*specs, done=done))
    for spec in specs:
        progress.begin(spec, done, 0)
    return progress


def test_table_of_one_trial_shows_rate_mean_and_time_left(terminal: Terminal, clock: Clock) -> None:
    progress = begun(terminal, clock, FIRST, done=10)
    for episode, value in ((11, 1.0), (12, 4.0)):
        clock.now += 0.5
        progress.episode(FIRST, result(episode, value))
    assert terminal.screen() == [
        "trial          episode  steps/s  return  mean of last 100  left",
        "sarsa/mines/0    12/50      200    4.00              2.50  19 s",
        bar(13, 24),
        "",
    ]


def test_episode_that_does_not_end_shows_its_steps_and_what_ends_it(terminal: Terminal, clock: Clock) -> None:
    log = io.StringIO()
    limited = replace(FIRST, max_steps=9)
    for progress in (begun(terminal, clock, FIRST), begun(log, clock, FIRST)):
        clock.now += 10
        progress.playing(FIRST, 1, 120_000)
    line = "sarsa/mines/0: episode 1 has 120,000 steps so far; --max-steps N (max_steps in a plan) cuts such"
    assert terminal.screen()[:2] == [line, "episodes off"]
    assert log.getvalue() == f"{line} episodes off\n"
    progress.begin(limited, 0, 0)
    clock.now += 10
    progress.playing(limited, 2, None)
    assert log.getvalue().endswith("sarsa/mines/0: episode 2 has not ended yet\n")
    clock.now += 10
    progress.episode(limited, result(2))
    assert "so far" not in log.getvalue().splitlines()[-1]


def test_trial_has_the_name_of_its_player_from_outside_once_that_has_joined(
    terminal: Terminal, clock: Clock
) -> None:
    progress = begun(terminal, clock, FIRST)
    progress.rename(FIRST, "Jumper/mines/0")
    clock.now += 0.5
    progress.episode(FIRST, result(1))
    assert terminal.screen()[1].startswith("Jumper/mines/0  ")


def test_table_of_many_trials_is_redrawn_in_place(terminal: Terminal, clock: Clock) -> None:
    progress = Progress(terminal, clock)
    progress.start(records(FIRST, SECOND, THIRD))
    for spec in (FIRST, SECOND):
        progress.begin(spec, 0, 0)
    for episode in (1, 2):
        for spec in (FIRST, SECOND):
            clock.now += 0.5
            progress.episode(spec, result(episode))
    progress.say("the agent sarsa was killed by signal 9; it is being restarted")
    clock.now += 0.5
    progress.episode(FIRST, result(3))
    assert terminal.screen() == [
        "the agent sarsa was killed by signal 9; it is being restarted",
        "trial          episode  steps/s  return  mean of last 100  left",
        "sarsa/mines/0     3/50      120    2.00              2.00  39 s",
        "sarsa/mines/1     2/50      100    2.00              2.00  48 s",
        "0 of 3 trials finished  episode 5/150  200 steps/s  1 min 12 s left",
        bar(1, 3),
        "",
    ]
    progress.close()
    assert terminal.screen() == ["the agent sarsa was killed by signal 9; it is being restarted", ""]


def test_table_fits_the_terminal(terminal: Terminal, clock: Clock) -> None:
    many = Plan(episodes=50, trials=30, agents=(RoleSweep("sarsa", label="x" * 90),)).expand()
    progress = begun(terminal, clock, *many)
    for spec in many:
        clock.now += 1
        progress.episode(spec, result(1))
    screen = terminal.screen()
    assert len(screen) <= 8
    assert all(len(line) < 100 for line in screen)
    assert screen[-4:-2] == [
        "and 27 more",
        "0 of 30 trials finished  episode 30/1500  100 steps/s  24 min 30 s left",
    ]


def test_narrow_terminal_shows_what_matters_most(terminal: Terminal, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("COLUMNS", "40")
    begun(terminal, Clock(1000.0), FIRST).episode(FIRST, result(25))
    assert terminal.screen()[:2] == ["trial          episode  left", "sarsa/mines/0    25/50   0 s"]
    assert terminal.screen()[2].endswith(" 50%")
    assert all(len(line) < 40 for line in terminal.screen())


@pytest.mark.parametrize("color", [False, True])
def test_bar_has_a_color_unless_that_is_not_wanted(terminal: Terminal, color: bool) -> None:
    begun(terminal, Clock(1000.0), FIRST, color=color).episode(FIRST, result(25))
    assert ("\x1b[32m" in terminal.getvalue()) is color


def test_trial_that_goes_back_counts_its_episodes_once(terminal: Terminal, clock: Clock) -> None:
    progress = begun(terminal, clock, FIRST, SECOND)
    for episode in (1, 2, 3):
        progress.episode(FIRST, result(episode))
    progress.begin(FIRST, 1, 0)
    for episode in (2, 3):
        clock.now += 1
        progress.episode(FIRST, result(episode))
    assert "0 of 2 trials finished  episode 3/100" in terminal.screen()[-3]


def test_without_a_terminal_a_line_is_written_every_few_seconds(clock: Clock) -> None:
    stream = io.StringIO()
    progress = begun(stream, clock, FIRST)
    for episode in range(1, 26):
        clock.now += 0.5
        progress.episode(FIRST, result(episode))
    progress.end(FIRST)
    progress.close()
    assert stream.getvalue().splitlines() == [
        "sarsa/mines/0  episode 20/50  200 steps/s  return 2.00  mean of last 20 2.00  15 s left",
        "sarsa/mines/0  episode 25/50  200 steps/s  return 2.00  mean of last 25 2.00  12 s left",
    ]


def test_json_lines_name_their_trial() -> None:
    stream, people = io.StringIO(), io.StringIO()
    lines = JsonLines(stream, people)
    lines.start(records(FIRST, SECOND))
    for spec in (FIRST, SECOND):
        lines.begin(spec, 0, 0)
    lines.episode(SECOND, result(1, math.nan))
    lines.episode(FIRST, result(1, -1.5))
    lines.say("a word")
    assert [json.loads(line) for line in stream.getvalue().splitlines()] == [
        {"trial": SECOND.id, "episode": 1, "return": None, "steps": 100, "terminal": True},
        {"trial": FIRST.id, "episode": 1, "return": -1.5, "steps": 100, "terminal": True},
    ]
    assert people.getvalue() == "a word\n"
