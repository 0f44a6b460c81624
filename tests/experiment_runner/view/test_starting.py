"""`--view`: the page of a run that is starting, and how it ends."""

from __future__ import annotations

import re
import signal
import subprocess
from pathlib import Path

import pytest

from tests.experiment_runner.view.pages import Page
from tests.system.runs import wait_until
from tests.terminal import BIN, run, watched_terminal

EXPERIMENT = ("glue-experiment", "--env", "skeleton", "--agent", "skeleton", "--episodes", "3", "--view")
COMPETITION = """\
trials = 1
seed_file = "secret.txt"
[tasks.walk]
env = "skeleton"
episodes = 1
[entrants.nobody]
command = ["true"]
"""


@pytest.fixture(autouse=True)
def no_display(monkeypatch: pytest.MonkeyPatch) -> None:
    """No test opens a browser on the desktop of whoever runs it."""
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)


def test_in_a_terminal_the_page_stays_after_the_run_until_ctrl_c(tmp_path: Path) -> None:
    with watched_terminal() as (writing, seen):
        command = [BIN / EXPERIMENT[0], *EXPERIMENT[1:], "--out", "out"]
        with subprocess.Popen(
            command, cwd=tmp_path, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=writing
        ) as process:
            try:
                for said in (b"until Ctrl-C\r\n", b"?token="):
                    wait_until(lambda said=said: said in b"".join(seen), said.decode())
                (url,) = re.findall(r"http://\S+", b"".join(seen).decode())
                page = Page(process, url)
                page.log_in()
                (shown,) = page.stream("topic=runs").next()["runs"].values()
                page.close()
                assert (shown["state"], shown["episodes"]) == ("finished", 3)
                assert page.stop(signal.SIGINT) == 0
            finally:
                process.kill()
    assert b"".join(seen).endswith(b"glue-view out\r\n")


def test_without_a_terminal_the_page_ends_with_the_run(tmp_path: Path) -> None:
    done = run(*EXPERIMENT, "--out", "out", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert "glue-view out" in done.stderr
    assert "until Ctrl-C" not in done.stderr


def test_a_competition_ends_so_too_and_can_be_verified_at_once(tmp_path: Path) -> None:
    (tmp_path / "small.toml").write_text(COMPETITION)
    (tmp_path / "secret.txt").write_text("only a test")
    done = run("glue-compete", "run", "small.toml", "--out", "out", "--view", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stderr.index("glue-compete verify out") < done.stderr.index("glue-view out")
