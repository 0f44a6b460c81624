"""Bad input: the hub answers or drops it, its memory does not grow, and other sessions are not disturbed.

A hub runs in a process of its own, and an honest session plays there throughout. Each test checks that the
session goes on as it would alone. What is wrong about single bytes, frames and messages is tried without
sockets, by `tests/glue/wire`, `tests/glue/hub` and `tests/fuzzing`; floods of all kinds by the attacker.
"""

from __future__ import annotations

import random
import socket
import struct
from collections.abc import Iterator
from contextlib import ExitStack

import pytest

from glue.hub.config import HubConfig
from glue.hub.io.channels import MAX_UNSEATED
from glue.hub.io.server import Hub
from glue.wire.messages import ErrorCode
from tests.scripted.curve import command
from tests.scripted.peer import ABORT, GREETING, ScriptedPeer, framed
from tests.system.attacks.siege import Honest, players
from tests.system.attacks.victim import victim

SESSION = "bad"
LIMIT, BODY, BESIDE = 8 * 2**20, 2**20, 4 * 2**20
"""The limit of the hub, the size of its largest body, and what it may use besides its limit, in bytes."""


class Target:
    """The hub under attack, with an honest session."""

    def __init__(self, url: str, honest: Honest) -> None:
        self._url = url
        self.honest = honest

    def connected(self) -> ScriptedPeer:
        """Return a connection on which nothing has been sent."""
        return ScriptedPeer(self._url, session=SESSION).connect()

    def greeted(self) -> ScriptedPeer:
        """Return a connection that has shaken hands."""
        return ScriptedPeer(self._url, session=SESSION).greet()


@pytest.fixture(scope="module")
def hub_with_session() -> Iterator[tuple[Target, Honest]]:
    with (
        victim(max_memory=LIMIT, max_body=BODY, heartbeat=0.2) as hub,
        players(hub.url, ["default"]),
    ):
        honest = Honest(hub.url, "default", {}, pause=0.02)
        idle = hub.begin()
        yield Target(hub.url, honest), honest
        honest.finish()
        assert hub.most() - idle <= LIMIT + BESIDE


@pytest.fixture
def hub(hub_with_session: tuple[Target, Honest]) -> Iterator[Target]:
    target, honest = hub_with_session
    yield target
    honest.check()


def test_random_bytes(hub: Target) -> None:
    noise = random.Random(1)
    for start in (b"", b"\xff", GREETING[:10], GREETING) * 10:
        with hub.connected() as connection:
            connection.send_bytes(start + noise.randbytes(noise.randint(1, 2000)))
    for _ in range(20):
        with hub.greeted() as connection:
            connection.send_bytes(noise.randbytes(noise.randint(1, 2000)))


def test_connections_that_say_nothing(hub: Target) -> None:
    with ExitStack() as silent:
        for _ in range(100):
            silent.enter_context(hub.connected())
            silent.enter_context(hub.greeted())
        hub.honest.check()


NOISE = framed(b"x")
PING = command(b"\x04PING\x00\x00")


@pytest.mark.parametrize(
    "frames", [NOISE * 5000, (NOISE * 10 + PING) * 500], ids=["noise", "with heartbeats"]
)
def test_floods_that_break_off(hub: Target, frames: bytes) -> None:
    """Send more than the hub reads ahead, and break the connection while it is held back."""
    for _ in range(10):
        with hub.greeted() as connection:
            connection.send_bytes(frames)
            connection.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, ABORT)


def test_a_message_without_an_end_is_not_kept(hub: Target) -> None:
    with hub.greeted() as connection:
        connection.join("agent", session="endless")
        for _ in range(2 * (LIMIT + BESIDE) // BODY):
            connection.send_bytes(b"\x03" + struct.pack(">Q", BODY) + bytes(BODY))


def test_of_connections_that_join_no_session_the_oldest_make_room() -> None:
    config = HubConfig(bind=("tcp://127.0.0.1:*",), heartbeat=60.0, timeout=600.0, farewell=0.0)
    extra = 4
    with Hub(config).in_background() as hub, ExitStack() as stack:
        connections = [
            stack.enter_context(ScriptedPeer(hub.endpoints[0]).connect()) for _ in range(MAX_UNSEATED + extra)
        ]
        for connection in connections[:extra]:
            connection.read_to_end()
        for connection in connections[extra:]:
            assert connection.read(64) == GREETING


def test_a_connection_that_joins_no_session_does_not_stay() -> None:
    config = HubConfig(bind=("tcp://127.0.0.1:*",), heartbeat=0.05, greeting=0.1)
    with Hub(config).in_background() as hub:
        url = hub.endpoints[0]
        with ScriptedPeer(url).connect() as silent, ScriptedPeer(url).greet() as greeted:
            for connection in (silent, greeted):
                connection.read_to_end()


def test_a_connection_that_joins_no_session_ends_at_its_first_malformed_message(hub: Target) -> None:
    with hub.greeted() as connection:
        connection.send_bytes(NOISE * 1000)
        assert connection.read_to_end().count(ErrorCode.MALFORMED.encode()) == 1
