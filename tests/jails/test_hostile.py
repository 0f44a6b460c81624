"""A competition in which all entrants except one misbehave; hostile/ has their programs."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from tests.house.imports import ROOT
from tests.system.runs import children

pytestmark = pytest.mark.timeout(1200)
"""The first test builds images and waits for two competitions."""

_REASONS = {
    "sleeps": "its bank of 3 s is empty",
    "drains": "its bank of 3 s is empty",
    "absent": "did not connect within 30 s",
    "crashes": "its program ended with status 3",
    "bombs": "its program used more than 256 MiB of memory",
    "fills": "its program ended with status 4",
    "floods": "did not connect within 30 s",
    "shouts": "did not connect within 30 s",
    "poses": "its program ended with status 5",
    "looks": "its program ended with status 6",
}
_FORBIDDEN = ("socket", "device", "load")
_FAIR = ("honest", "leaves")
_TRIALS = 2

_SECRET = "the-organisers-canary"
_COMMAND = ["glue_rl", "compete"]
_MATCH = "experiment_runner.competition.worker"
_SECONDS = 800

_FILE = """
name = "hostile"
trials = {trials}
seed_file = "secret.txt"
tasks.easy = {{ env = "mines", options.random_start = true, steps = 300 }}
[limits]
step_seconds = 0.5
bank_seconds = 3
start_seconds = 30
memory = "256m"
tmp = "16m"
shm = "8m"
pids = 64
log = "256k"
"""


@dataclass(frozen=True)
class Held:
    """A competition that was held.

    Attributes:
        directory: the run's directory.
        printed: what the commands printed.
        verified: the exit status of `glue-compete verify`.
        board: the standings.
        peak: the peak memory of a hub's process, in KiB.
    """

    directory: Path
    printed: str
    verified: int
    board: dict[str, Any]
    peak: int

    def standing(self, entrant: str) -> dict[str, Any]:
        (found,) = (each for each in self.board["entrants"] if each["name"] == entrant)
        return dict(found)

    def log(self, entrant: str, trial: int = 0) -> str:
        return (self.directory / f"logs/{entrant}/easy/{trial}.log").read_text(errors="replace")


def hold(folder: Path, images: dict[str, str]) -> Held:
    """Hold a competition of these entrants, and verify it."""
    lines = [f'[entrants.{name}]\nimage = "{image}"\n' for name, image in images.items()]
    (folder / "competition.toml").write_text(_FILE.format(trials=_TRIALS) + "".join(lines))
    (folder / "secret.txt").write_text(_SECRET)
    (folder / "secret.txt").chmod(0o600)
    peaks: list[int] = [0]
    over = threading.Event()
    watch = threading.Thread(target=_watch_memory, args=(peaks, over))
    watch.start()
    try:
        run = _compete("run", folder / "competition.toml", "--out", folder / "run", "--workers", "2")
    finally:
        over.set()
        watch.join()
    assert run.returncode == 0, run.stderr
    verified = _compete("verify", folder / "run")
    board = json.loads(_compete("board", folder / "run", "--format", "json").stdout)
    printed = run.stdout + run.stderr + verified.stdout + verified.stderr
    return Held(folder / "run", printed, verified.returncode, board, max(peaks))


def _compete(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-P", "-m", *_COMMAND, *map(str, arguments)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False, timeout=_SECONDS)


def _watch_memory(peaks: list[int], over: threading.Event) -> None:
    while not over.wait(0.1):
        for process in children(os.getpid(), _MATCH):
            with suppress(OSError):
                status = Path(f"/proc/{process}/status").read_text()
                peaks += [int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM")]


@pytest.fixture(scope="module")
def held(build: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory) -> Held:
    images = {name: build(name) for name in (*_FAIR, *_REASONS)}
    return hold(tmp_path_factory.mktemp("hostile"), images)


@pytest.fixture(scope="module")
def alone(build: Callable[[str], str], tmp_path_factory: pytest.TempPathFactory) -> Held:
    return hold(tmp_path_factory.mktemp("alone"), {"honest": build("honest")})


def test_every_score_is_verified(held: Held) -> None:
    assert held.verified == 0, held.printed
    assert f"{len(_FAIR + tuple(_REASONS)) * _TRIALS} of" in held.printed


def test_the_honest_entrant_earns_what_it_earns_alone(held: Held, alone: Held) -> None:
    tasks = held.standing("honest")["tasks"]["easy"], alone.standing("honest")["tasks"]["easy"]
    assert tasks[0]["trials"] == tasks[1]["trials"]
    assert not held.standing("honest")["forfeits"]


@pytest.mark.parametrize("entrant", _REASONS)
def test_each_is_on_the_board_with_its_reason(held: Held, entrant: str) -> None:
    reasons = [forfeit["reason"] for forfeit in held.standing(entrant)["forfeits"]]
    assert len(reasons) == _TRIALS
    for reason in reasons:
        assert _REASONS[entrant] in reason
        assert reason.isprintable()


def test_nothing_is_left_for_the_next_process(held: Held) -> None:
    for trial in range(_TRIALS):
        assert "left in /tmp" in held.log("leaves", trial)
        assert "found" not in held.log("leaves", trial)
    fair = [held.standing(name)["tasks"]["easy"]["trials"] for name in _FAIR]
    assert fair[0] == fair[1]


def test_nobody_believes_a_pose(held: Held) -> None:
    lines = held.log("poses").splitlines()
    poses = [line for line in lines if line.startswith(("environment:", "experiment:", "agent of"))]
    assert len(poses) >= 5
    assert all(": Refused: " in line for line in poses), poses


def test_nothing_was_found_or_reached(held: Held) -> None:
    for trial in range(_TRIALS):
        log = held.log("looks", trial)
        assert "looked everywhere" in log
        for line in log.splitlines():
            assert not line.startswith(("reached ", "gained ", *(f"found {what} " for what in _FORBIDDEN))), (
                line
            )
        for treasure in (_SECRET, str(held.directory), "competition.toml", "results.sqlite"):
            assert treasure not in log


def test_every_disk_was_full_at_its_limit(held: Held) -> None:
    log = held.log("fills")
    assert "/tmp: No space left on device after 16 MiB" in log
    assert "/dev/shm: No space left on device after 8 MiB" in log
    assert "/run/glue: Read-only file system after 0 MiB" in log
    assert log.count(" after 0 MiB") == 8


def test_what_was_printed_was_kept_up_to_its_limit(held: Held) -> None:
    assert "the last words of crashes" in held.log("crashes")
    assert 0 < len(held.log("shouts")) <= 256 * 1024


def test_the_memory_of_the_hubs_stayed_bounded(held: Held, alone: Held) -> None:
    """The flood sends messages of the largest size over many connections, and never completes one."""
    assert alone.peak > 0
    assert held.peak < alone.peak + 256 * 1024


def test_no_container_is_left(held: Held, engine: Any) -> None:
    for name in (*_FAIR, *_REASONS):
        assert not engine.containers.list(all=True, filters={"ancestor": f"glue-test/{name}"})


def test_two_checks_at_once_leave_each_others_containers_alone(
    held: Held, build: Callable[[str], str], tmp_path: Path
) -> None:
    (tmp_path / "competition.toml").write_text(
        _FILE.format(trials=1) + f'[entrants.honest]\nimage = "{build("honest")}"\n'
    )
    arguments = [sys.executable, "-P", "-m", *_COMMAND, "check", str(tmp_path / "competition.toml"), "--out"]
    checks = [subprocess.Popen([*arguments, str(tmp_path / out)], cwd=ROOT) for out in ("a", "b", "c")]
    assert [check.wait(_SECONDS) for check in checks] == [0, 0, 0]
