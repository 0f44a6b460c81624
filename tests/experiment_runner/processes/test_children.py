from __future__ import annotations

import os
import signal
import threading
from pathlib import Path

import pytest

from experiment_runner.processes.children import KeptAlive
from tests.system.runs import children


def test_player_that_cannot_be_restarted_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    given_up = threading.Event()
    reasons: list[str] = []

    def give_up(reason: str) -> None:
        reasons.append(reason)
        given_up.set()

    before = set(children(os.getpid()))
    with KeptAlive(
        "agent Lazy",
        "http.server",
        ["--bind", "127.0.0.1", "0"],
        say=lambda line: None,
        progress=lambda: 0,
        give_up=give_up,
        dismissed=False,
    ):
        monkeypatch.setattr("sys.executable", str(tmp_path / "no such program"))
        for child in set(children(os.getpid())) - before:
            os.kill(child, signal.SIGKILL)
        assert given_up.wait(60)
    assert "agent Lazy cannot be restarted" in reasons[0]
    assert "no such program" in reasons[0] or "No such file" in reasons[0]
