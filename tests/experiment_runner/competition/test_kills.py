"""SIGKILL of the organiser at any time: the competition continues to the same standings."""

from __future__ import annotations

import json
import random
import subprocess
import sys
import time
from pathlib import Path
from subprocess import DEVNULL

import pytest

from tests.experiment_runner.competition.contest import compete
from tests.proof import size
from tests.system.runs import kill

KILLS = size(4, 20)
"""Number of kills of the organiser."""

TRIALS, STEPS, EPISODES = size((1, 1000, 20), (2, 3000, 50))

LONGEST_LIFE = 3.0
"""Seconds until a kill, at most; an organiser that is over by then has nothing to lose."""

COMPETE = [sys.executable, "-m", "glue_rl", "compete"]

FILE = f"""\
name = "spring"
trials = {TRIALS}
seed_file = "secret.txt"
tasks.mines = {{ env = "mines", options.random_start = true, steps = {STEPS} }}
tasks.walk = {{ env = "skeleton", episodes = {EPISODES} }}
entrants.sarsa = {{ command = ["AGENT", "sarsa"] }}
entrants.random = {{ command = ["AGENT", "random"] }}
"""


def standings(folder: Path, out: str) -> object:
    compete(folder, "verify", out)
    return json.loads(compete(folder, "board", out, "--format", "json"))


@pytest.mark.proof
@pytest.mark.stage("kills")
@pytest.mark.timeout(900)
def test_an_organiser_that_is_killed_comes_to_the_same_standings(tmp_path: Path) -> None:
    agent = Path(sys.executable).with_name("glue-agent")
    (tmp_path / "spring.toml").write_text(FILE.replace("AGENT", str(agent)))
    (tmp_path / "secret.txt").write_text("xyzzy")
    command = ("run", "spring.toml", "--workers", "2", "--out")
    compete(tmp_path, *command, "undisturbed")
    chance = random.Random(4)
    for number in range(KILLS):
        killed = [*COMPETE, *command, run_of(number)]
        organiser = subprocess.Popen(killed, cwd=tmp_path, stdout=DEVNULL, stderr=DEVNULL)
        time.sleep(chance.uniform(0, LONGEST_LIFE))
        kill(organiser)
    expected = standings(tmp_path, "undisturbed")
    for out in sorted({run_of(number) for number in range(KILLS)}):
        compete(tmp_path, *command, out)
        assert standings(tmp_path, out) == expected


def run_of(number: int) -> str:
    """Return the name of the run to kill: each run gets a few kills, early, midway and late."""
    return f"killed-{number // 5}"
