"""The control socket: what it answers, and what nobody can do to it."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from experiment_runner.competition.season.control import (
    CONTROL,
    Attempt,
    Door,
    NoServer,
    Reply,
    Request,
    Status,
    TryLater,
    ask,
)
from glue.errors import ExperimentError


def answer(request: Request) -> Reply:
    match request:
        case Status():
            return {"state": "fine"}
        case Attempt("late"):
            raise TryLater("come again", 7.0)
        case _:
            raise ExperimentError(f"no {type(request).__name__}")


@contextmanager
def served(directory: Path, answer: Callable[[Request], Reply] = answer) -> Iterator[None]:
    """Answer requests in a thread."""
    over = threading.Event()
    with Door(directory) as door:

        def serve() -> None:
            while not over.is_set():
                door.serve(answer, 0.01)

        server = threading.Thread(target=serve)
        server.start()
        try:
            yield
        finally:
            over.set()
            server.join()


@pytest.fixture
def door(tmp_path: Path) -> Iterator[Path]:
    with served(tmp_path):
        yield tmp_path


def test_a_request_has_one_reply(door: Path) -> None:
    assert ask(door, {"do": "status"}) == {"ok": True, "state": "fine"}
    late = {"ok": False, "error": "come again", "retry_after": 7.0}
    assert ask(door, {"do": "attempt", "entrant": "late"}) == late
    assert ask(door, {"do": "attempt", "entrant": "alice"}) == {"ok": False, "error": "no Attempt"}
    assert (door / CONTROL).stat().st_mode & 0o777 == 0o600  # it is its owner's alone


@pytest.mark.parametrize(
    ("request_", "why"),
    [
        ({"do": "everything"}, "Invalid value 'everything'"),
        ({"do": "attempt"}, "missing required field `entrant`"),
        ({"do": "attempt", "entrant": 7}, "Expected `str`"),
        ({"do": "attempt", "entrant": "\udcff"}, "surrogate"),
        ({"do": "status", "more": 1}, "unknown field"),
        ([], "Expected `object`"),
    ],
)
def test_what_is_no_request_is_refused(door: Path, request_: Any, why: str) -> None:
    reply = ask(door, request_)
    assert not reply["ok"]
    assert why in reply["error"]


def test_a_flood_and_a_silent_client_delay_nobody(door: Path) -> None:
    with socket.socket(socket.AF_UNIX) as silent, socket.socket(socket.AF_UNIX) as flood:
        for client in (silent, flood):
            client.connect(str(door / CONTROL))
        silent.sendall(b'{"do":')
        with pytest.raises(ConnectionError):
            flood.sendall(b"x" * 10_000_000)
        assert ask(door, {"do": "status"})["ok"]


def test_many_clients_at_once_are_all_served(door: Path) -> None:
    clients = [socket.socket(socket.AF_UNIX) for _ in range(100)]
    for client in clients:
        client.connect(str(door / CONTROL))
        client.sendall(b'{"do": "status"}\n')
    assert all(json.loads(client.makefile().readline())["ok"] for client in clients)
    for client in clients:
        client.close()


def test_a_client_that_sends_nothing_is_dropped(tmp_path: Path) -> None:
    now = 0.0
    with Door(tmp_path, lambda: now) as door, socket.socket(socket.AF_UNIX) as client:
        client.connect(str(tmp_path / CONTROL))
        door.serve(answer, 1)
        now = 60.0
        door.serve(answer, 0)
        assert client.recv(1) == b""


def test_without_a_server_that_is_said(tmp_path: Path) -> None:
    with pytest.raises(NoServer, match="no server answers"):
        ask(tmp_path, {"do": "status"})
    Door(tmp_path).close()
    assert not (tmp_path / CONTROL).exists()


def test_a_reply_that_is_cut_off_is_no_reply(tmp_path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / CONTROL))
        listener.listen()

        def answer_in_part() -> None:
            client, _ = listener.accept()
            with client:
                client.recv(100)
                client.sendall(b'{"ok": ')

        server = threading.Thread(target=answer_in_part)
        server.start()
        with pytest.raises(NoServer, match="its reply is not whole"):
            ask(tmp_path, {"do": "status"})
        server.join()


def test_a_deep_directory_has_a_socket(tmp_path: Path) -> None:
    deep = tmp_path.joinpath(*["x" * 60] * 3)
    deep.mkdir(parents=True)
    with served(deep):
        assert ask(deep, {"do": "status"})["ok"]
