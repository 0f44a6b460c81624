"""docs/season.md and docs/teaching.md are carried out, from the file to the certificate."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import urllib.request
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, Final

import pytest

from experiment_runner.cli.compete import compete
from tests.pages import DOCS, RUNS, Block, blocks, run_block
from tests.ports import ports
from tests.system.runs import wait_until

__all__ = ["ports"]

BACKGROUND: Final = "runs in the background"
UNIT: Final = DOCS / "examples" / "season" / "glue-season.service"
COMPOSE: Final = DOCS.parent / "docker" / "season.yaml"
PATH: Final = f"{Path(sys.executable).parent}:/usr/bin:/bin"
SLOTS: Final = 4


def text_of(page: str, port: int) -> str:
    """Return a page's text with other ports than the usual ones."""
    text = (DOCS / f"{page}.md").read_text(encoding="utf-8")
    return text.replace("4097", str(port)).replace("8097", str(port + SLOTS))


@contextmanager
def in_background(block: Block, folder: Path) -> Iterator[subprocess.Popen[bytes]]:
    """Run a block until the context ends; the season's page answers, if it has one."""
    with (folder / "log").open("ab") as log:
        command = ["bash", "-c", f"exec {block.body}"]
        process = subprocess.Popen(command, cwd=folder, env={"PATH": PATH}, stdout=log, stderr=log)
    try:
        if page := re.search(r"--page (\S+)", block.body):
            wait_until(lambda: health(page[1]) == 200, "the page")
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        assert process.wait(60) in (0, 130), (folder / "log").read_text()


@contextmanager
def again_and_again(block: Block, folder: Path, *entrants: str) -> Iterator[None]:
    """Run the block of alice for each of these entrants, at the same time, until the context ends."""
    with ExitStack() as stack:
        for name in entrants:
            command = ["bash", "-c", block.body.replace("alice", name)]
            process = subprocess.Popen(command, cwd=folder, env={"PATH": PATH}, start_new_session=True)
            stack.callback(process.wait)
            stack.callback(os.killpg, process.pid, signal.SIGKILL)
        yield


def health(address: str) -> int:
    """Return the status of a page's health; 0 if it does not answer."""
    try:
        with urllib.request.urlopen(f"http://{address}/healthz", timeout=10) as response:
            return int(response.status)
    except OSError:
        return 0


def board_at(port: int) -> dict[str, Any]:
    """Return the public board."""
    with urllib.request.urlopen(f"http://127.0.0.1:{port + SLOTS}/season.json", timeout=60) as response:
        found: dict[str, Any] = json.load(response)
        return found


class Followed:
    """A page whose blocks are run one after the other."""

    def __init__(self, page: str, folder: Path, port: int) -> None:
        self.folder = folder
        self.port = port
        self.url = f"http://127.0.0.1:{port + SLOTS}"
        self._blocks = iter(blocks(text_of(page, port)))

    def until(self, note: str) -> Block:
        """Write and run everything up to a block with this note, and return that block."""
        for block in self._blocks:
            if block.file:
                (self.folder / block.file).write_text(block.body, encoding="utf-8")
            elif block.note == note:
                return block
            else:
                assert block.note == RUNS, block
                self.run(block)
        raise AssertionError(note)

    def run(self, block: Block) -> str:
        """Run a block; return what it printed."""
        done = run_block(block, self.folder)
        return done.stdout + done.stderr


@pytest.mark.stage("docs")
@pytest.mark.slow
def test_a_season_goes_from_its_file_to_its_certificate(tmp_path: Path, ports: int) -> None:
    page = Followed("season", tmp_path, ports)
    serve = page.until(BACKGROUND)
    with in_background(serve, tmp_path):
        backup = page.until(f"{RUNS}: a backup")
        board = board_at(page.port)
        assert board["announcements"][0]["text"] == "The server moves on Friday."
        assert any("misunderstanding" in act for act in board["acts"])
    assert "verified" in page.run(backup)
    with in_background(serve, tmp_path) as server:
        page.run(Block(RUNS, "sh", f"glue-compete join {page.url} --code plum --name bob --dir bob"))
        shutil.copy(tmp_path / "bob" / "bob.key_secret", tmp_path)
        final = page.until(f"{BACKGROUND}: final")
        assert server.wait(120) == 0
    assert json.loads((tmp_path / "public" / "season.json").read_text())["state"] == "closed"
    each = page.until(f"{BACKGROUND}: for each entrant")
    with in_background(final, tmp_path) as run, again_and_again(each, tmp_path, "alice", "bob"):
        assert run.wait(240) == 0
    played = re.findall(r"(\w+)/final/\d: \S+ in 10 episodes", (tmp_path / "log").read_text())
    assert sorted(played) == ["alice"] * 3 + ["bob"] * 3
    printed = page.run(page.until(f"{RUNS}: results"))
    assert "signed with" in printed
    certificate = (tmp_path / "board.html").read_text()
    assert "alice" in certificate
    assert "Every score was verified by replay" in certificate


@pytest.mark.stage("docs")
@pytest.mark.slow
def test_a_class_is_taught_and_graded(tmp_path: Path, ports: int) -> None:
    page = Followed("teaching", tmp_path, ports)
    with in_background(page.until(BACKGROUND), tmp_path):
        grades = page.until(f"{RUNS}: grades")
        (mia,) = board_at(page.port)["entrants"]
        assert (mia["place"], mia["counts"]) == (1, {"verified": 1})
        page.run(grades)
    assert "mia" in (tmp_path / "grades.csv").read_text()


def test_the_unit_and_the_container_start_a_season_with_options_that_there_are() -> None:
    for line in (unit()["ExecStart"], container()):
        _, command, *arguments = shlex.split(line)
        compete.commands[command].make_context(command, arguments)
    gateway = re.search(r"gateway: ([\d.]+)", COMPOSE.read_text("utf-8"))
    assert gateway is not None
    assert f"--proxy-address {gateway[1]}\n" in container()


def unit() -> dict[str, str]:
    """Return the settings of the unit."""
    text = UNIT.read_text("utf-8").replace("\\\n", " ")
    return dict(line.split("=", 1) for line in text.splitlines() if re.match(r"\w+=", line))


def container() -> str:
    """Return the command of the container."""
    found = re.search(r"command: >-\n((?: {6}.*\n)+)", COMPOSE.read_text("utf-8"))
    assert found is not None
    return "glue-compete serve " + re.sub(r"\$\{\w+:-([^}]*)\}", r"\1", found[1])


def test_the_unit_can_be_loaded_and_exposes_little(tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("needs systemd-analyze")
    text = UNIT.read_text("utf-8").replace("/opt/glue/bin/glue-compete", "/bin/true")
    path = tmp_path / UNIT.name
    path.write_text(re.sub("(?m)^User=.*", "DynamicUser=yes", text))
    loaded = subprocess.run(["systemd-analyze", "verify", str(path)], capture_output=True, text=True)
    assert (loaded.returncode, loaded.stderr) == (0, "")
    exposed = ["systemd-analyze", "security", "--offline=true", "--threshold=20", str(path)]
    assert subprocess.run(exposed, capture_output=True).returncode == 0  # of 100; 96 without hardening
