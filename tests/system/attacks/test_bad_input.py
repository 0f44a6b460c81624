"""Bad input: the hub answers or drops it, its memory does not grow, and other sessions are not disturbed.

A hub runs in a process of its own, and an honest session plays there throughout. Each test checks that the
session goes on as it would alone. What is wrong about single bytes, frames and messages is tried without
sockets, by `tests/glue/wire` and `tests/glue/hub/test_sessions.py`.
"""

from __future__ import annotations

import random
import socket
import struct
from collections.abc import Iterator
from contextlib import ExitStack, suppress

import pytest

from glue.client.experiment import connect
from glue.hub.config import HubConfig
from glue.hub.io.channels import MAX_UNSEATED
from glue.hub.io.server import Hub
from glue.wire.limits import MAX_HEADER
from glue.wire.messages import ErrorCode, Kind
from tests.scripted.curve import command
from tests.scripted.peer import ABORT, GREETING, READY, ScriptedPeer, framed
from tests.system.attacks.siege import Honest, players
from tests.system.attacks.victim import victim

SESSIONS = 64
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

    def greeted(self, receive_buffer: int = 0) -> ScriptedPeer:
        """Return a connection that has shaken hands."""
        return ScriptedPeer(self._url, session=SESSION, receive_buffer=receive_buffer).greet()


@pytest.fixture(scope="module")
def hub_with_session() -> Iterator[tuple[Target, Honest]]:
    with (
        victim(max_memory=LIMIT, max_body=BODY, max_sessions=SESSIONS, heartbeat=0.2) as hub,
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


@pytest.fixture
def client(hub: Target) -> Iterator[ScriptedPeer]:
    with hub.greeted() as client:
        yield client


# Bytes


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


@pytest.mark.parametrize("size", [BODY + 2 * MAX_HEADER, 2**40, 2**63 - 1])
def test_a_frame_that_claims_to_be_giant_costs_its_sender_the_connection(hub: Target, size: int) -> None:
    with hub.greeted() as connection:
        connection.send_bytes(b"\x02" + struct.pack(">Q", size) + bytes(1000))
        connection.read_to_end()


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


def test_a_peer_that_sends_little_may_finish_while_others_fill_the_memory(hub: Target) -> None:
    with ExitStack() as stack:
        modest = stack.enter_context(hub.greeted())
        modest.join("agent")
        for number in range(2 * LIMIT // BODY):
            peer = stack.enter_context(hub.greeted())
            peer.join("agent", session=f"greedy {number}")
            peer.send_bytes(b"\x02" + struct.pack(">Q", BODY) + bytes(BODY - 100))
        hub.honest.check()
        modest.say(Kind.AGENT_MESSAGE, 9, body=bytes(2**17))
        assert modest.error()[0] == ErrorCode.NOT_ASKED, "the modest one was not dropped"


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


@pytest.mark.parametrize(
    "start",
    [
        b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n".ljust(64),
        GREETING + b"\x00\x01x",
        GREETING + READY + b"\x08\x01x",
        GREETING + b"\x06" + struct.pack(">Q", 2**20),
    ],
    ids=["http", "a message before READY", "unknown flags", "a giant command"],
)
def test_a_peer_that_is_not_a_dealer_is_dropped(hub: Target, start: bytes) -> None:
    with hub.connected() as connection:
        connection.send_bytes(start)
        connection.read_to_end()


# Frames


def test_random_frames_are_answered_with_an_error(hub: Target) -> None:
    noise = random.Random(3)
    for _ in range(50):
        with hub.greeted() as client:
            client.send(*[noise.randbytes(noise.randint(0, 60)) for _ in range(noise.randint(1, 4))])
            assert client.error()[0] in (ErrorCode.MALFORMED, ErrorCode.UNKNOWN_KIND)


def test_a_connection_that_joins_no_session_ends_at_its_first_malformed_message(hub: Target) -> None:
    with hub.greeted() as connection:
        connection.send_bytes(NOISE * 1000)
        assert connection.read_to_end().count(ErrorCode.MALFORMED.encode()) == 1


BOMBS = {
    "an array of four billion": b"\xdd\xff\xff\xff\xff",
    "a map of four billion": b"\xdf\xff\xff\xff\xff",
    "a text of four billion": b"\xdb\xff\xff\xff\xff",
    "binary of four billion": b"\xc6\xff\xff\xff\xff",
    "an extension of four billion": b"\xc9\xff\xff\xff\xff\x05",
    "arrays in arrays": b"\x91" * MAX_HEADER,
    "a megabyte of arrays in arrays": b"\x91" * 2**20,
}


@pytest.mark.parametrize("name", BOMBS)
def test_a_msgpack_bomb_is_answered_with_an_error(client: ScriptedPeer, name: str) -> None:
    client.send(BOMBS[name])
    assert client.error()[0] == ErrorCode.MALFORMED


def test_a_message_of_many_frames_is_answered_with_an_error(client: ScriptedPeer) -> None:
    client.join("agent", session="many frames")
    client.send(*[b"frame"] * 50_000)
    assert client.error() == (ErrorCode.MALFORMED, "a message has one or two frames; 3 received")


# Floods


def test_a_flood_of_hellos_leaves_room_for_others(hub: Target) -> None:
    with hub.greeted() as flood:
        outcomes = []
        for number in range(500):
            flood.hello("agent", session=f"flood {number}")
            outcomes.append(flood.receive())
        assert sum(message.kind is Kind.WELCOME for message in outcomes) == SESSIONS // 4
        code, text = map(str, outcomes[-1].scalars)
        assert (code, f"{SESSIONS // 4} sessions" in text) == (ErrorCode.FULL, True)
        with hub.greeted() as late:
            late.join("agent", session="late")


def test_a_flood_of_hellos_and_goodbyes(hub: Target, client: ScriptedPeer) -> None:
    for number in range(300):
        client.join("agent", session=f"{number}")
        client.say(Kind.GOODBYE, 0, "x" * 3000, session=f"{number}")


def test_a_flood_of_heartbeats_from_one_that_never_reads(hub: Target) -> None:
    with hub.greeted() as client, suppress(OSError):
        client.join("agent", session="never read")
        client.socket.settimeout(0.5)  # the hub stops reading from it
        heartbeat = client.encoded(*client.frames_of(Kind.HEARTBEAT, 1, session="never read"))
        for _ in range(50):
            client.send_bytes(heartbeat * 10_000)


def test_a_hub_whose_log_nobody_reads_goes_on() -> None:
    with (
        victim(log_is_read=False) as hub,
        connect(hub.url, "s") as glue,
        ScriptedPeer(hub.url).greet() as refused,
    ):
        refused.join("agent", session="so that it may stay")
        for _ in range(2000):
            refused.hello("experiment", session="s")
            assert refused.error()[0] == ErrorCode.ROLE_TAKEN
        assert glue.rl_num_episodes() == 0


def test_an_experiment_that_never_reads_its_replies(hub: Target) -> None:
    large = bytes(BODY - 16)
    with hub.greeted() as agent, hub.greeted(4096) as experiment, suppress(OSError):
        agent.join("agent", session="unread")
        experiment.hello("experiment", session="unread")
        experiment.say(Kind.RL_AGENT_MESSAGE, 1, session="unread")
        call = agent.receive()
        agent.say(Kind.AGENT_MESSAGE, call.seq, body=large, session="unread")
        experiment.socket.settimeout(0.5)  # the hub stops reading from it
        for _ in range(1000):
            experiment.say(Kind.RL_AGENT_MESSAGE, 1, session="unread")
            experiment.hello("experiment", session="unread")
