from __future__ import annotations

import itertools
import os
import queue
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


def test_a_child_that_exits_is_restarted_if_it_has_a_time_to_rest() -> None:
    said: queue.Queue[str] = queue.Queue()
    with KeptAlive(
        "page",
        "http.server",
        ["--no-such-option"],
        say=said.put,
        progress=itertools.count().__next__,
        give_up=said.put,
        dismissed=False,
        rest=0.01,
    ):
        for _ in range(2):
            assert said.get(timeout=60) == "the page ended with status 2; it is being restarted"
