"""The test client and its programs are themselves held against the recordings of original programs."""

from __future__ import annotations

import json
import socket
import struct
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tests.system.legacy.legacy_client import (
    STYLES,
    TIMEOUT,
    Closed,
    Connection,
    Experiment,
    serve_agent,
    serve_environment,
)
from tests.system.legacy.legacy_programs import AGENTS, CASES, ENVIRONMENTS, EXPERIMENTS

CAPTURES = Path(__file__).parents[2] / "golden" / "captures"


def receive(connection: socket.socket, size: int) -> bytes:
    """Return the next `size` bytes, fewer only if the other side closes before."""
    data = b""
    while len(data) < size and (chunk := connection.recv(size - len(data))):
        data += chunk
    return data


class Replay:
    """The server's half of one recorded connection; it insists on the client's half."""

    def __init__(self, capture: str, role: str) -> None:
        recorded = json.loads((CAPTURES / f"{capture}.json").read_text())["frames"]
        self._events = [event for event in recorded if event["role"] == role]
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self.frames = 0

    def run(self) -> None:
        """Serve one client.

        Raises:
            AssertionError: the client sent anything else than what was recorded.
        """
        self._listener.settimeout(TIMEOUT)
        connection, _ = self._listener.accept()
        connection.settimeout(TIMEOUT)
        with self._listener, connection:
            for event in self._events:
                self._play(event, connection)

    def _play(self, event: dict[str, Any], connection: socket.socket) -> None:
        from_client = event["from"] == "client"
        if event.get("event") == "eof":
            if from_client:
                assert connection.recv(1) == b""
            else:
                connection.shutdown(socket.SHUT_WR)
        elif "hex" in event:
            recorded = bytes.fromhex(event["hex"])
            if from_client:
                got = receive(connection, len(recorded))
                assert got == recorded, f"{event['name']}, number {event['seq']}"
            else:
                connection.sendall(recorded)
            self.frames += 1


def play_against(replay: Replay, client: Callable[[], object]) -> None:
    """Run `client` against `replay`; fail if either does."""
    failures: list[BaseException] = []

    def run() -> None:
        try:
            client()
        except BaseException as error:  # handed to the test's own thread
            failures.append(error)

    thread = threading.Thread(target=run)
    thread.start()
    try:
        replay.run()
    finally:
        thread.join(TIMEOUT)
    assert failures == []
    assert not thread.is_alive()
    assert replay.frames > 0


RECORDED = [
    ("c_test_sanity", "A1", "E1", "test_sanity"),
    ("c_test_1", "A1", "E1", "test_1"),
    ("c_test_rl_episode", "A1", "E1", "test_rl_episode"),
    ("c_test_message", "A-message", "E-message", "test_message"),
    ("raw_term", "A1", "E1", None),
    ("c_skeleton", None, "skeleton", "skeleton"),
]


@pytest.mark.parametrize(("capture", "agent"), [(row[0], row[1]) for row in RECORDED if row[1]])
def test_our_agents_send_what_the_originals_sent(capture: str, agent: str) -> None:
    replay = Replay(capture, "agent")
    play_against(replay, lambda: serve_agent(AGENTS[agent](), Connection(replay.port)))


@pytest.mark.parametrize(("capture", "environment"), [(row[0], row[2]) for row in RECORDED])
def test_our_environments_send_what_the_originals_sent(capture: str, environment: str) -> None:
    replay = Replay(capture, "environment")
    play_against(replay, lambda: serve_environment(ENVIRONMENTS[environment](), Connection(replay.port)))


@pytest.mark.parametrize(("capture", "experiment"), [(row[0], row[3]) for row in RECORDED if row[3]])
def test_our_experiments_send_what_the_originals_sent(capture: str, experiment: str) -> None:
    replay = Replay(capture, "experiment")

    def client() -> None:
        connection = Connection(replay.port)
        EXPERIMENTS[experiment](Experiment(connection))
        connection.close()

    play_against(replay, client)


def test_every_case_names_programs_that_exist() -> None:
    assert CASES.keys() == EXPERIMENTS.keys()
    for agent, environment in CASES.values():
        assert agent in AGENTS
        assert environment in ENVIRONMENTS


@pytest.mark.parametrize(
    ("style", "expected"),
    [("c", bytes.fromhex("0000002300000000")), ("python", bytes.fromhex("0000000200000000")), ("lisp", b"")],
)
def test_each_style_answers_the_goodbye_in_its_own_way(style: str, expected: bytes) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        connection = Connection(listener.getsockname()[1], STYLES[style])
        server, _ = listener.accept()
        with server:
            server.sendall(struct.pack(">iI", 35, 0))
            serve_agent(AGENTS["A1"](), connection)
            assert receive(server, 8) == bytes.fromhex("0000000200000000")
            assert receive(server, 8) == expected


def test_a_java_client_loses_the_second_of_two_frames_that_come_together() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        connection = Connection(listener.getsockname()[1], STYLES["java"])
        server, _ = listener.accept()
        with server:
            server.sendall(struct.pack(">iIiI", 8, 0, 35, 0))
        assert connection.receive() == (8, b"")
        with pytest.raises(Closed):
            connection.receive()
        connection.close()


def test_a_java_client_counts_utf16_units_and_sends_utf8() -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        connection = Connection(listener.getsockname()[1], STYLES["java"])
        server, _ = listener.accept()
        connection.send_text(10, "é🎲")
        connection.close()
        with server:
            assert receive(server, 64) == struct.pack(">iII", 10, 7, 3) + "é🎲".encode()
