"""A trial in progress, shown by a page: real experiments, which are not affected."""

from __future__ import annotations

import base64
import contextlib
import json
import signal
import socket
import stat
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from experiment_runner.store.layout import HUBS_FILE, LiveSession, live_sessions, put_live_sessions
from glue.types import Action, Observation, body_size
from tests.experiment_runner.view.pages import Page, Stream, glue_view
from tests.terminal import Terminal

ENDLESS = ("glue-experiment", "--agent", "random", "--episodes", "1000000")


@pytest.fixture
def page(tmp_path: Path) -> Iterator[Page]:
    with glue_view(tmp_path) as page:
        yield page


@contextlib.contextmanager
def playing(*options: str, env: str = "mines", cwd: Path) -> Iterator[None]:
    """Run an experiment until the context ends, and then press Ctrl-C."""
    with contextlib.closing(Terminal(*ENDLESS, "--env", env, *options, cwd=cwd)) as running:
        yield
        running.send_signal(signal.SIGINT)
        assert running.end() == 130


def started(page: Page, stream: Stream) -> str:
    """Wait for a run to be in progress, and return its id."""
    while True:
        for run in (stream.next().get("runs") or {}).values():
            if run and run["state"] == "running" and run["episodes"]:
                return str(run["id"])


def until(stream: Stream, topic: str, key: str, known: dict[str, Any]) -> Any:
    """Return the next value of a key other than None; keep all values in `known`."""
    while True:
        values = stream.next().get(topic) or {}
        known |= values
        if values.get(key) is not None:
            return values[key]


def test_a_page_sees_what_is_played_and_the_run_does_not_change(page: Page, tmp_path: Path) -> None:
    with playing("--out", "a", cwd=tmp_path):
        run_id = started(page, page.stream("topic=runs"))
        file = tmp_path / "a" / HUBS_FILE
        assert stat.S_IMODE(file.stat().st_mode) == 0o600
        ((trial, live),) = live_sessions(tmp_path / "a").items()
        assert live.hub.startswith("ipc:///")
        topic = f"live:{run_id}"
        stream, known = page.stream(f"topic={topic}"), dict[str, Any]()
        steps: set[int] = set()
        while len(steps) < 3:
            moment = until(stream, topic, "moment", known)
            body = base64.b64decode(moment["seen"])
            cut = body_size(body)
            action, seen = Action.from_body(body[:cut]), Observation.from_body(body[cut:])
            assert seen.counts == (1, 0, 0)
            assert 0 <= seen.ints[0] < 108
            assert moment["step"] == 0 or action.ints[0] in range(4)
            if not moment["ending"]:
                assert moment["return"] == -moment["step"]  # each step costs 1
                assert moment["reward"] == (-1 if moment["step"] else 0)
            steps.add(moment["step"])
        assert (known["trial"], known["trials"], known["spec"]["extra"]) == (trial, [trial], "mines")
        other = page.stream(f"topic=live:{run_id}/{trial}")
        assert until(other, f"{topic}/{trial}", "moment", {})
    assert not file.exists()
    while known["trial"] is not None:
        known |= stream.next().get(topic) or {}


@pytest.mark.stage("page")
def test_a_run_that_was_killed_is_not_shown_as_going_on(page: Page, tmp_path: Path) -> None:
    with contextlib.closing(Terminal(*ENDLESS, "--env", "mines", "--out", "a", cwd=tmp_path)) as running:
        topic = f"live:{started(page, page.stream('topic=runs'))}"
        stream, known = page.stream(f"topic={topic}"), dict[str, Any]()
        until(stream, topic, "moment", known)
        assert known["trial"] is not None
        running.send_signal(signal.SIGKILL)
        running.end()
    while known["trial"] is not None:
        known |= stream.next().get(topic) or {}


@pytest.mark.stage("page")
def test_nothing_is_named_where_there_is_no_hub(page: Page, tmp_path: Path) -> None:
    with playing("--out", "a", "--in-process", cwd=tmp_path):
        run_id = started(page, page.stream("topic=runs"))
        assert not (tmp_path / "a" / HUBS_FILE).exists()
        stream = page.stream(f"topic=live:{run_id}")
        first: dict[str, Any] = {}
        while first.keys() != {"trials", "trial"}:
            first |= stream.next()[f"live:{run_id}"]
        assert first == {"trials": [], "trial": None}


def test_there_is_no_topic_of_what_is_no_run(page: Page) -> None:
    assert page.stream("topic=live:0").next() == {"live:0": None}
    assert page.stream("topic=live:..%2F..").next() == {"live:../..": None}


def test_trials_come_and_go(tmp_path: Path) -> None:
    file = tmp_path / HUBS_FILE
    file.write_text("left behind")
    put_live_sessions(tmp_path, {})
    assert not file.exists()
    sessions = {
        "a/b/0": LiveSession("tcp://127.0.0.1:4097", "default"),
        "a/b/1": LiveSession("tcp://[::1]:4097", "b"),
    }
    put_live_sessions(tmp_path, sessions)
    assert live_sessions(tmp_path) == sessions
    del sessions["a/b/0"]
    put_live_sessions(tmp_path, sessions)
    assert live_sessions(tmp_path).keys() == {"a/b/1"}
    put_live_sessions(tmp_path, {})
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "[" * 100_000,
        '{"a": 1}',
        '{"a": [1, 2]}',
        '{"a": ["tcp://192.0.2.1:4097", "default"]}',
        '{"a": ["tcp://127.0.0.1.evil.example:4097", "default"]}',
        '{"a": ["http://127.0.0.1/", "default"]}',
        '{"a": ["ipc:///etc/passwd", "default"]}',
        '{"a": ["ipc://@hidden", "default"]}',
        '{"a": ["ipc:///nowhere/\\u0000", "default"]}',
        '{"a": ["tcp://127.0.0.1:4097", ""]}',
    ],
)
def test_a_file_from_elsewhere_leads_nowhere_else(tmp_path: Path, text: str) -> None:
    (tmp_path / HUBS_FILE).write_text(text)
    assert live_sessions(tmp_path) == {}


def test_a_link_is_not_followed_and_a_socket_is_one_of_ours(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(tmp_path / "hub"))
        (tmp_path / "true.json").write_text(json.dumps({"a": [f"ipc://{tmp_path}/hub", "default"]}))
        (tmp_path / HUBS_FILE).symlink_to(tmp_path / "true.json")
        assert live_sessions(tmp_path) == {}
        (tmp_path / "true.json").replace(tmp_path / HUBS_FILE)
        assert live_sessions(tmp_path) == {"a": LiveSession(f"ipc://{tmp_path}/hub", "default")}
