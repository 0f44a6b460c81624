"""`--view`: the page of a run that is starting, and the page's end."""

from __future__ import annotations

from pathlib import Path

import pytest

from experiment_runner.processes import children
from experiment_runner.view.launch import COMMAND
from tests.experiment_runner.view.pages import in_terminal
from tests.forked import run
from tests.system.runs import wait_until

EXPERIMENT = ("glue-experiment", "--env", "skeleton", "--agent", "skeleton", "--episodes", "3")


@pytest.mark.stage("page")
def test_in_a_terminal_the_page_stays_after_the_run_until_ctrl_c(tmp_path: Path) -> None:
    with in_terminal(*EXPERIMENT, "--out", "out", cwd=tmp_path) as (page, seen):
        wait_until(lambda: b"until Ctrl-C\r\n" in b"".join(seen), "the end of the run")
        (shown,) = page.stream("topic=runs").next()["runs"].values()
        assert (shown["state"], shown["episodes"]) == ("finished", 3)
        assert page.stop() == 0
    assert b"".join(seen).endswith(b"glue-view out\r\n")


@pytest.mark.stage("page")
def test_without_a_terminal_the_page_ends_with_the_run(tmp_path: Path) -> None:
    done = run(*EXPERIMENT, "--out", "out", "--view", cwd=tmp_path, status=0)
    assert "glue-view out" in done.stderr
    assert "until Ctrl-C" not in done.stderr


def test_the_page_is_a_command_in_a_child_process(capfd: pytest.CaptureFixture[str]) -> None:
    process = children.start(COMMAND, ["--help"])
    assert process.wait(60) == 0
    assert "Show the runs in each DIR" in capfd.readouterr().out
    children.end(process)
