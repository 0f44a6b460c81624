"""Entrants from elsewhere: one with a key gets onto a verified board, and nobody else gets in."""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("nacl", reason="needs PyNaCl: pip install 'glue-rl[keys]'")

from experiment_runner.competition.match import Forfeited, Match, play
from experiment_runner.competition.settings import Entrant, Gate, Limits
from experiment_runner.competition.starters import starter_for
from experiment_runner.competition.trials import trials
from glue.client.libzmq import new_pair
from glue.client.players import serve_agent
from glue.errors import GlueError
from glue.keys.certificates import write_pair
from tests import forked
from tests.experiment_runner.competition.players import SECRET, Walker, competition

_FILE = """\
name = "spring"
seed_file = "secret.txt"
[tasks.mines]
env = "mines"
options = { random_start = true }
steps = 20
[entrants.carol]
key = "carol.key"
"""

_PROGRAM = """\
import os, sys
from pathlib import Path
from glue import serve_agent
from glue.errors import GlueError
from tests.experiment_runner.competition.players import Walker

while not Path("over").exists():
    print(sorted(name for name in os.environ if name.startswith("GLUE")), flush=True)
    try:
        serve_agent(Walker(), wait=0.5)  # its place is in the environment
    except GlueError as error:
        print(error, file=sys.stderr)
"""


def compete(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    return forked.run("glue-compete", *arguments, cwd=folder)


@pytest.mark.slow
def test_one_who_joins_with_a_key_gets_to_the_verified_board(tmp_path: Path) -> None:
    (tmp_path / "spring.toml").write_text(_FILE)
    (tmp_path / "secret.txt").write_text("xyzzy")
    (tmp_path / "secret.txt").chmod(0o600)
    write_pair(tmp_path / "keys", "hub", new_pair())
    write_pair(tmp_path, "carol", new_pair())
    url = f"ipc://{tmp_path}/gate"
    place = {
        "GLUE_HUB": url,
        "GLUE_SESSION": "carol",
        "GLUE_KEY": "carol.key_secret",
        "GLUE_HUB_KEY": "keys/hub.key",
        "PYTHONPATH": str(Path(__file__).parents[3]),
    }
    program = subprocess.Popen([sys.executable, "-c", _PROGRAM], cwd=tmp_path, env={**os.environ, **place})
    try:
        done = compete(tmp_path, "run", "spring.toml", "--out", "run", "--keys", "keys", "--bind", url)
    finally:
        (tmp_path / "over").touch()
        program.kill()
        program.wait()
    assert done.returncode == 0, done.stderr
    assert "forfeited" not in done.stderr
    assert "its log is where its program is" in (tmp_path / "run/logs/carol/mines/0.log").read_text()
    verified = compete(tmp_path, "verify", "run")
    assert "1 of 1 trials are verified" in verified.stderr
    (carol,) = json.loads(compete(tmp_path, "board", "run", "--format", "json").stdout)["entrants"]
    assert (carol["name"], carol["place"], carol["forfeits"]) == ("carol", 1, [])
    assert carol["id"] in (tmp_path / "carol.key").read_text()


def reports_of(folder: Path, program: Callable[[str, Path], object]) -> list[Any]:
    """Let a program join Carol's trial at an address of this machine; time is over when it has tried."""
    write_pair(folder / "keys", "hub", new_pair())
    write_pair(folder, "carol", new_pair())
    held = competition("carol", limits=Limits(start_seconds=1.0))
    entrant = Entrant("carol", key=folder / "carol.key")
    url = f"ipc://{folder}/gate"
    (spec,) = trials(held, SECRET)
    match = Match(spec, entrant, held.limits, 40, folder / "log", "test", Gate(url, folder / "keys"))
    reports: list[Any] = []
    tried = threading.Event()

    def attempt() -> None:
        with suppress(GlueError):
            program(url, folder)
        tried.set()

    threading.Thread(target=attempt, daemon=True).start()
    ticks = itertools.count()

    def clock() -> float:
        return float(next(ticks)) if tried.is_set() else 0.0

    play(match, reports.append, starter_for(entrant), clock=clock)
    return reports


def with_another_key(url: str, folder: Path) -> None:
    write_pair(folder, "mallory", new_pair())
    join(url, folder / "mallory.key_secret", "carol")


def as_another(url: str, folder: Path) -> None:
    join(url, folder / "carol.key_secret", "dave")


def without_a_key(url: str, folder: Path) -> None:
    serve_agent(Walker(), url, "carol", wait=1.0)


def nobody(url: str, folder: Path) -> None:
    pass


def join(url: str, key: Path, session: str) -> None:
    hub_key = key.parent / "keys" / "hub.key"
    serve_agent(Walker(), url, session, key=key, hub_key=hub_key, wait=1.0)


@pytest.mark.parametrize("program", [nobody, with_another_key, as_another, without_a_key])
def test_nobody_else_gets_in_and_who_does_not_come_forfeits(
    program: Callable[[str, Path], object], tmp_path: Path
) -> None:
    reports = reports_of(tmp_path, program)
    (forfeit,) = (report for report in reports if isinstance(report, Forfeited))
    assert forfeit.reason == "it did not connect within 1 s"
