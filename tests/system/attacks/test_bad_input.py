"""Bad input: the hub answers or drops it, its memory does not grow, and other sessions are not disturbed.

A hub runs in a process of its own, and a healthy session uses it throughout. Each test checks that the
session has made progress; at the end its returns equal those of a run without bad input.
"""

from __future__ import annotations

import random
import socket
import struct
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path

import msgpack
import pytest

from glue.client.experiment import connect
from glue.engine.local import local
from glue.hub.config import HubConfig
from glue.hub.io.channels import MAX_UNSEATED
from glue.hub.io.server import Hub
from glue.types import Action, Observation
from glue.wire.limits import MAX_BODY, MAX_HEADER
from glue.wire.messages import ErrorCode, Kind
from tests.forked import Recorded
from tests.players import ChainAgent, ChainEnvironment
from tests.scripted.curve import METADATA, command
from tests.scripted.peer import ABORT, GREETING, READY, TIMEOUT, ScriptedPeer, framed, hello_scalars
from tests.scripted.process import main, running

SESSIONS = 64
ROOM = 150
"""Megabytes that the hub may grow by in one test: some of the largest bodies, not hundreds."""


class HealthySession:
    """An agent and an environment in processes of their own, and an experiment in a thread that plays on."""

    def __init__(self, hub: subprocess.Popen[str], url: str) -> None:
        self._hub = hub
        self._returns: list[float] = []
        self._more = threading.Condition()
        self._stop = False
        self._failure: Exception | None = None
        players = (("agent", "ChainAgent"), ("environment", "ChainEnvironment"))
        self._players = [Recorded(main, role, url, f"tests.players:{player}") for role, player in players]
        self._glue = connect(url)
        self._thread = threading.Thread(target=self._play)
        self._thread.start()

    def _play(self) -> None:
        try:
            with self._glue as glue:
                glue.rl_init()
                while not self._stop:
                    assert glue.rl_episode()
                    with self._more:
                        self._returns.append(glue.rl_return())
                        self._more.notify()
        except Exception as error:
            self._failure = error

    def goes_on(self) -> None:
        """Wait for a few more episodes."""
        deadline = time.monotonic() + TIMEOUT
        with self._more:
            wanted = len(self._returns) + 3
            while len(self._returns) < wanted:
                assert self._hub.poll() is None, "the hub has died"
                assert self._failure is None
                assert time.monotonic() < deadline, "the session stands still"
                self._more.wait(1.0)

    def finish(self) -> list[float]:
        """Stop playing, and return the returns of all episodes."""
        self._stop = True
        self._thread.join(TIMEOUT)
        assert self._failure is None
        return self._returns

    def close(self) -> None:
        """End all programs, with or without a hub."""
        self._glue.give_up("the test is over")
        self._thread.join(TIMEOUT)
        for player in self._players:
            player.kill()


class Target:
    """The hub under attack."""

    def __init__(self, url: str, process: subprocess.Popen[str], healthy: HealthySession) -> None:
        self.url = url
        self._process = process
        self.healthy = healthy

    def connected(self) -> ScriptedPeer:
        """Return a connection on which nothing has been sent."""
        return ScriptedPeer(self.url, session=SESSION).connect()

    def greeted(self, receive_buffer: int = 0) -> ScriptedPeer:
        """Return a connection that has shaken hands."""
        return ScriptedPeer(self.url, session=SESSION, receive_buffer=receive_buffer).greet()

    def megabytes(self) -> int:
        """Return the memory of the hub's process, in megabytes."""
        status = Path(f"/proc/{self._process.pid}/status").read_text()
        return int(status.split("VmRSS:")[1].split()[0]) // 1024


@contextmanager
def target() -> Iterator[Target]:
    """A hub in a process of its own, with a session that plays."""
    program = "from glue.cli.hub import main; main()"
    settings = [
        "--heartbeat",
        "0.2",
        "--timeout",
        "1",
        "--max-sessions",
        str(SESSIONS),
        "--max-memory",
        "64",
    ]
    with running("-c", program, "--bind", "tcp://127.0.0.1:*", *settings) as process:
        assert process.stderr is not None
        url = process.stderr.readline().split()[-1]
        # Its log of refusals must not fill the pipe.
        threading.Thread(target=process.stderr.read, daemon=True).start()
        healthy = HealthySession(process, url)
        try:
            healthy.goes_on()
            yield Target(url, process, healthy)
        finally:
            healthy.close()
            process.terminate()
            process.wait(TIMEOUT)


@pytest.fixture(scope="module")
def _hub() -> Iterator[Target]:
    with target() as hub:
        yield hub
        returns = hub.healthy.finish()
    glue = local(ChainAgent(), ChainEnvironment())
    glue.rl_init()
    for number, total in enumerate(returns):
        assert glue.rl_episode()
        assert glue.rl_return() == total, f"episode {number}"


@pytest.fixture
def hub(_hub: Target) -> Iterator[Target]:
    before = _hub.megabytes()
    yield _hub
    _hub.healthy.goes_on()
    assert _hub.megabytes() < before + ROOM


SESSION = "bad"


@pytest.fixture
def client(hub: Target) -> Iterator[ScriptedPeer]:
    with hub.greeted() as client:
        yield client


# Bytes


def test_random_bytes(hub: Target) -> None:
    noise = random.Random(1)
    for start in (b"", b"\xff", GREETING[:10], GREETING) * 20:
        with hub.connected() as connection:
            connection.send_bytes(start + noise.randbytes(noise.randint(1, 2000)))


def test_random_bytes_after_a_handshake(hub: Target) -> None:
    noise = random.Random(2)
    for _ in range(40):
        with hub.greeted() as connection:
            connection.send_bytes(noise.randbytes(noise.randint(1, 2000)))


def test_connections_that_say_nothing(hub: Target) -> None:
    with ExitStack() as silent:
        for _ in range(100):
            silent.enter_context(hub.connected())
            silent.enter_context(hub.greeted())
        hub.healthy.goes_on()


@pytest.mark.parametrize("size", [MAX_BODY + 2 * MAX_HEADER, 2**40, 2**63 - 1])
def test_a_frame_that_claims_to_be_giant_costs_its_sender_the_connection(hub: Target, size: int) -> None:
    with hub.greeted() as connection:
        connection.send_bytes(b"\x02" + struct.pack(">Q", size) + bytes(1000))
        connection.read_to_end()


def test_frames_that_break_off_hold_no_memory(hub: Target) -> None:
    for _ in range(20):
        with hub.greeted() as connection:
            connection.send_bytes(b"\x02" + struct.pack(">Q", MAX_BODY) + bytes(100_000))


def flood_and_reset(hub: Target, frames: bytes) -> None:
    """Send more than the hub reads ahead, and break the connection while it is held back."""
    for _ in range(20):
        with hub.greeted() as connection:
            connection.send_bytes(frames)
            connection.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, ABORT)


NOISE = framed(b"x")
PING = command(b"\x04PING\x00\x00")


def test_floods_that_break_off(hub: Target) -> None:
    flood_and_reset(hub, NOISE * 5000)


def test_floods_with_heartbeats_in_them_that_break_off(hub: Target) -> None:
    flood_and_reset(hub, (NOISE * 10 + PING) * 500)


def test_a_message_without_an_end_is_not_kept(hub: Target) -> None:
    with hub.greeted() as connection:
        connection.join("agent", session="endless")
        for _ in range(ROOM + 20):
            connection.send_bytes(b"\x03" + struct.pack(">Q", 2**20) + bytes(2**20))


def test_messages_that_do_not_come_to_their_end_are_dropped_when_they_are_too_many(hub: Target) -> None:
    before = hub.megabytes()
    with ExitStack() as stack:
        for _ in range(25):
            connection = stack.enter_context(hub.greeted())
            with suppress(ConnectionError):
                connection.send_bytes(b"\x02" + struct.pack(">Q", MAX_BODY) + bytes(MAX_BODY - 1))
            assert hub.megabytes() < before + ROOM


def test_a_peer_that_sends_little_may_finish_while_others_fill_the_memory(hub: Target) -> None:
    with ExitStack() as stack:
        modest, *greedy = [stack.enter_context(hub.greeted()) for _ in range(5)]
        modest.join("agent")
        for number, peer in enumerate(greedy):
            peer.join("agent", session=f"greedy {number}")
            peer.send_bytes(b"\x02" + struct.pack(">Q", MAX_BODY) + bytes(MAX_BODY - 100))
        hub.healthy.goes_on()
        modest.say(Kind.AGENT_MESSAGE, 9, body=bytes(2**20))
        assert modest.error()[0] == ErrorCode.NOT_ASKED, "the modest one was not dropped"


def test_of_connections_that_join_no_session_the_oldest_make_room() -> None:
    hub = Hub(HubConfig(bind=("tcp://127.0.0.1:*",), heartbeat=60.0, timeout=600.0))
    with hub.in_background(), ExitStack() as stack:
        connections = [stack.enter_context(ScriptedPeer(hub.endpoints[0]).connect()) for _ in range(300)]
        for connection in connections[300 - MAX_UNSEATED :]:
            assert connection.read(64) == GREETING
        for connection in connections[: 300 - MAX_UNSEATED]:
            connection.read_to_end()
        assert not connections[-MAX_UNSEATED].can_read(0.01)


def test_a_connection_that_joins_no_session_does_not_stay(hub: Target) -> None:
    with hub.connected() as silent, hub.greeted() as greeted:
        for connection in (silent, greeted):
            connection.read_to_end()


@pytest.mark.parametrize(
    "start",
    [
        b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n".ljust(64),
        GREETING[:10] + b"\x02" + GREETING[11:],
        GREETING[:12] + b"CURVE".ljust(20, b"\0") + GREETING[32:],
        GREETING + command(b"\x05READY" + METADATA.replace(b"\x06DEALER", b"\x03REQ")),
        GREETING + b"\x04\x06\x05READY",
        GREETING + b"\x00\x01x",
        GREETING + READY + b"\x05\x01x",
        GREETING + READY + b"\x08\x01x",
        GREETING + b"\x06" + struct.pack(">Q", 2**20),
    ],
    ids=[
        "http",
        "an older version",
        "another mechanism",
        "another socket",
        "no socket",
        "a message before READY",
        "a command with more",
        "unknown flags",
        "a giant command",
    ],
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


@pytest.mark.parametrize("count", [3, 1000, 100_000])
def test_a_message_of_many_frames_is_answered_with_an_error(client: ScriptedPeer, count: int) -> None:
    client.join("agent", session=f"{count} frames")
    client.send(*[b"frame"] * count)
    assert client.error() == (ErrorCode.MALFORMED, "a message has one or two frames; 3 received")


def test_a_body_too_large_is_answered_with_an_error(client: ScriptedPeer) -> None:
    client.send(msgpack.packb([19, "bad", 1]), bytes(MAX_BODY + 1))
    code, text = client.error()
    assert code == ErrorCode.MALFORMED
    assert f"the body of ENV_MESSAGE has {MAX_BODY + 1} bytes; {MAX_BODY} are allowed" in text


def test_counts_that_do_not_add_up_are_answered_with_an_error(client: ScriptedPeer) -> None:
    client.send(msgpack.packb([12, "bad", 1]), struct.pack("<4I", 2**32 - 1, 2**32 - 1, 2**32 - 1, 0))
    code, text = client.error()
    assert code == ErrorCode.MALFORMED
    assert "the counts in the body of ENV_START say" in text


def test_the_largest_bodies_leave_no_trace(hub: Target, client: ScriptedPeer) -> None:
    client.join("environment")
    for _ in range(8):
        client.send(msgpack.packb([19, "bad", 1]), bytes(MAX_BODY))
        assert client.error()[0] == ErrorCode.NOT_ASKED


# Messages out of place


def test_an_unknown_kind(client: ScriptedPeer) -> None:
    client.send(msgpack.packb([999, "bad", 5]))
    message = client.receive()
    assert (message.kind, message.seq, message.scalars[0]) == (Kind.ERROR, 5, ErrorCode.UNKNOWN_KIND)


def test_an_unknown_version(client: ScriptedPeer) -> None:
    client.say(Kind.HELLO, 0, (2,), *hello_scalars("agent")[1:])
    assert client.error() == (ErrorCode.VERSION, "this hub supports protocol version 1, the peer [2]")


def test_an_unknown_role(client: ScriptedPeer) -> None:
    client.hello("king")
    assert client.error()[0] == ErrorCode.MALFORMED


def test_no_hello(client: ScriptedPeer) -> None:
    client.say(Kind.RL_START, 1, session="default")
    assert client.error()[0] == ErrorCode.UNKNOWN_PEER


@pytest.mark.parametrize("role", ["agent", "environment", "experiment"])
def test_a_second_of_each_role(client: ScriptedPeer, role: str) -> None:
    client.hello(role, session="default")
    code, text = client.error()
    assert code == ErrorCode.ROLE_TAKEN
    assert f"session 'default' already has an {role}" in text


def test_replies_without_a_call(client: ScriptedPeer) -> None:
    client.join("environment")
    for seq in (0, 1, 2**63 - 1):
        client.say(Kind.ENV_STEP, seq, 1.0, True, body=Observation().body)
        assert client.error()[0] == ErrorCode.NOT_ASKED


def test_messages_of_another_role(client: ScriptedPeer) -> None:
    client.join("agent")
    for kind, body in ((Kind.ENV_START, Observation().body), (Kind.RL_START, b"")):
        client.say(kind, 1, body=body)
        assert client.error()[0] == ErrorCode.NOT_ASKED


def test_a_malformed_message_costs_its_sender_its_role(client: ScriptedPeer) -> None:
    client.join("agent")
    client.send(b"nonsense")
    assert client.error()[0] == ErrorCode.MALFORMED
    client.say(Kind.HEARTBEAT, 0)
    assert client.error()[0] == ErrorCode.UNKNOWN_PEER


def test_a_routing_id_of_ones_own_is_of_no_account(hub: Target) -> None:
    with hub.connected() as client:
        client.send_bytes(GREETING + command(b"\x05READY" + METADATA + b"\x08Identity\x00\x00\x00\x04mine"))
        client.read(len(GREETING))
        client.read_frame()
        client.join("agent")


# Floods


def test_a_flood_of_hellos_leaves_room_for_others(hub: Target) -> None:
    with hub.greeted() as flood:
        outcomes = []
        for number in range(2000):
            flood.hello("agent", session=f"flood {number}")
            outcomes.append(flood.receive())
        assert sum(message.kind is Kind.WELCOME for message in outcomes) == SESSIONS // 4
        code, text = map(str, outcomes[-1].scalars)
        assert (code, f"{SESSIONS // 4} sessions" in text) == (ErrorCode.FULL, True)
        with hub.greeted() as late:
            late.join("agent", session="late")


def test_floods_of_hellos_from_many_connections_fill_no_more_than_the_sessions_there_are(
    hub: Target,
) -> None:
    with ExitStack() as stack:
        floods = [stack.enter_context(hub.greeted()) for _ in range(4)]
        outcomes = []
        for number in range(SESSIONS):
            flood = floods[number % len(floods)]
            flood.hello("agent", session=f"flood {number}")
            outcomes.append(flood.receive())
        assert outcomes[-1].scalars == (
            ErrorCode.FULL,
            f"this hub serves {SESSIONS} sessions at once, and all are in use",
        )
        # Once the floods have gone, their sessions are free again.
        for number in range(SESSIONS):
            floods[number % len(floods)].say(Kind.GOODBYE, 0, "over", session=f"flood {number}")
        for flood in floods:
            flood.say(Kind.HEARTBEAT, 1, session="flood 0")
            assert flood.error()[0] == ErrorCode.UNKNOWN_PEER
        with hub.greeted() as late:
            late.join("agent", session="late")


def test_a_flood_of_hellos_and_goodbyes(hub: Target, client: ScriptedPeer) -> None:
    for number in range(700):
        client.join("agent", session=f"{number}")
        client.say(Kind.GOODBYE, 0, "x" * 3000, session=f"{number}")


def test_a_flood_of_heartbeats_from_one_that_never_reads(hub: Target) -> None:
    with hub.greeted() as client, suppress(ConnectionError):
        client.join("agent", session="never read")
        for _ in range(50_000):
            client.say(Kind.HEARTBEAT, 1, session="never read")


def test_a_hub_whose_log_nobody_reads_goes_on() -> None:
    program = "from glue.cli.hub import main; main()"
    with running("-c", program, "--bind", "tcp://127.0.0.1:*") as process:
        assert process.stderr is not None
        url = process.stderr.readline().split()[-1]
        with connect(url, "s") as glue, ScriptedPeer(url).greet() as refused:
            refused.join("agent", session="so that it may stay")
            for _ in range(2000):
                refused.hello("experiment", session="s")
                assert refused.error()[0] == ErrorCode.ROLE_TAKEN
            assert glue.rl_num_episodes() == 0
        process.kill()


def test_an_experiment_that_never_reads_its_replies(hub: Target) -> None:
    large = bytes(2**20)
    with hub.greeted() as agent, hub.greeted(4096) as experiment, suppress(ConnectionError):
        agent.join("agent", session="unread")
        experiment.hello("experiment", session="unread")
        experiment.say(Kind.RL_AGENT_MESSAGE, 1, session="unread")
        call = agent.receive()
        agent.say(Kind.AGENT_MESSAGE, call.seq, body=large, session="unread")
        for _ in range(5000):
            experiment.say(Kind.RL_AGENT_MESSAGE, 1, session="unread")
            experiment.hello("experiment", session="unread")


def test_a_player_that_answers_everything_with_the_largest_body(hub: Target) -> None:
    huge = Action(chars=bytes(MAX_BODY - 16)).body
    with hub.greeted() as agent, hub.greeted() as experiment:
        agent.join("agent")
        experiment.join("experiment")
        while experiment.receive().kind is not Kind.NOTICE:
            pass
        for seq in (1, 2):
            experiment.say(Kind.RL_AGENT_START, seq, body=Observation().body)
            agent.say(Kind.AGENT_START, agent.receive().seq, body=huge)
            assert experiment.receive().body == huge
