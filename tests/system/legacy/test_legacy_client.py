"""The test client itself is checked against recordings of original programs."""

from __future__ import annotations

import json
import socket
import struct
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from env_server.toys import SkeletonEnvironment
from glue.roles import Agent, Environment
from tests.system.conformance import (
    EPISODES,
    FiveStepEnvironment,
    MessageAgent,
    MessageEnvironment,
    MirrorAgent,
)
from tests.system.legacy.legacy_client import (
    STYLES,
    TIMEOUT,
    Closed,
    Connection,
    Experiment,
)
from tests.system.legacy.legacy_rig import play_agent, play_environment

CAPTURES = Path(__file__).parents[2] / "golden" / "captures"


def receive(connection: socket.socket, size: int) -> bytes:
    """Return the next `size` bytes, or fewer if the other side closes first."""
    data = b""
    while len(data) < size and (chunk := connection.recv(size - len(data))):
        data += chunk
    return data


class Replay:
    """The server's half of one recorded connection; checks that the client's half is as recorded."""

    def __init__(self, capture: str, role: str) -> None:
        recorded = json.loads((CAPTURES / f"{capture}.json").read_text())["frames"]
        self._events = [event for event in recorded if event["role"] == role]
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self.frames = 0

    def run(self) -> None:
        """Serve one client.

        Raises:
            AssertionError: the client's bytes differ from the recording.
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
        except BaseException as error:  # reported by the test's own thread
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


class OriginalSkeleton(SkeletonEnvironment):
    """The skeleton environment with the task spec of the original."""

    def env_init(self) -> str:
        return (
            "VERSION RL-Glue-3.0 PROBLEMTYPE episodic DISCOUNTFACTOR 1.0 OBSERVATIONS INTS (0 20) "
            "ACTIONS INTS (0 1)  REWARDS (-1.0 1.0)  EXTRA skeleton_environment(C/C++) by Brian Tanner."
        )


AGENTS: dict[str, Callable[[], Agent]] = {
    "c_test_sanity": MirrorAgent,
    "c_test_1": MirrorAgent,
    "c_test_rl_episode": MirrorAgent,
    "c_test_message": MessageAgent,
    "raw_term": MirrorAgent,
}
ENVIRONMENTS: dict[str, Callable[[], Environment]] = {
    "c_test_sanity": FiveStepEnvironment,
    "c_test_1": FiveStepEnvironment,
    "c_test_rl_episode": FiveStepEnvironment,
    "c_test_message": MessageEnvironment,
    "raw_term": FiveStepEnvironment,
    "c_skeleton": OriginalSkeleton,
}


@pytest.mark.parametrize("capture", AGENTS)
def test_agents_send_what_the_originals_sent(capture: str) -> None:
    replay = Replay(capture, "agent")
    play_against(replay, lambda: play_agent(AGENTS[capture](), Connection(replay.port)))


@pytest.mark.parametrize("capture", ENVIRONMENTS)
def test_environments_send_what_the_originals_sent(capture: str) -> None:
    replay = Replay(capture, "environment")
    play_against(replay, lambda: play_environment(ENVIRONMENTS[capture](), Connection(replay.port)))


Verbs = Callable[[Experiment], None]


def sanity(glue: Experiment) -> None:
    assert glue.init() == "sample task spec"
    glue.cleanup()


def one(glue: Experiment) -> None:
    glue.init()
    glue.start()
    for word in ("one", "two", "three", "four", "five"):
        glue.step()
        assert glue.env_message(word).startswith(f"{word}|")
        assert glue.agent_message(word).startswith(f"{word}|")
    reward, observation, terminal, _ = glue.step()
    assert (reward, observation.counts, terminal) == (-2.0, (5, 5, 5), 0)
    glue.cleanup()


def rl_episode(glue: Experiment) -> None:
    glue.init()
    assert [(glue.episode(limit), glue.num_steps()) for limit in EPISODES] == [*EPISODES.values()]
    glue.cleanup()


def message(glue: Experiment) -> None:
    glue.init()
    environment, agent = glue.env_message, glue.agent_message
    for send, text in (
        *((environment, None), (environment, ""), (agent, None), (agent, "")),
        *((send, text) for text in ("empty", "null", "1", f"1{21 * '0'}") for send in (environment, agent)),
        (environment, f"2{55 * '1'}3{55 * '1'}3"),
        (agent, f"4{55 * '5'}6{55 * '5'}9"),
    ):
        assert send(text) == {None: "empty", "": "empty", "empty": "", "null": ""}.get(text, text)
    glue.cleanup()


def skeleton(glue: Experiment) -> None:
    assert "skeleton_environment" in glue.init()
    for send in (glue.agent_message, glue.env_message):
        assert send("what is your name?").startswith("my name is skeleton_")
        send("If at first you don't succeed; call it version 1.0")
    for limit in (100, 100, 100, 100, 100, 1, 0):
        terminal = glue.episode(limit)
        assert abs(glue.episode_return()) == terminal
        glue.num_steps()
    glue.cleanup()
    glue.init()
    glue.start()
    while not glue.step()[2]:
        pass
    glue.episode_return()
    glue.num_steps()
    glue.cleanup()


EXPERIMENTS: dict[str, Verbs] = {
    "c_test_sanity": sanity,
    "c_test_1": one,
    "c_test_rl_episode": rl_episode,
    "c_test_message": message,
    "c_skeleton": skeleton,
}


@pytest.mark.parametrize("capture", EXPERIMENTS)
def test_experiments_send_what_the_originals_sent(capture: str) -> None:
    replay = Replay(capture, "experiment")

    def client() -> None:
        connection = Connection(replay.port)
        EXPERIMENTS[capture](Experiment(connection))
        connection.close()

    play_against(replay, client)


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
            play_agent(MirrorAgent(), connection)
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
